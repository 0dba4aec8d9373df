"""docs/reliability.md: the matrix from the table, and what was measured, a section for each driver."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from bench.reliability.rig import SLACK, Rig
from bench.reliability.rigs import RIGS
from bench.reliability.table import FAULTS, Way, full

PAGE: Final = Path(__file__).parents[2] / "docs" / "reliability.md"

INTRODUCTION: Final = f"""# Reliability

Twenty faults, met by the drivers of [the matrix](#the-matrix) at their simulators, over the wire that the
hardware has. Five drivers are [outside the matrix](#drivers-outside-the-matrix), which names the tests of
their faults. `python -m bench.faults --write` writes this page, but for
[simulated worlds](#simulated-worlds): `python -m bench.world --write` writes that section.
`tests/all_devices/test_matrix.py` runs a part of the same table in CI (each way in which a driver meets
a fault, and each activity); the command runs all of it: at rest, in each kind of stream and of move, and
while a joint homes.

In each cell the state and its reason are announced, and the joints come to stand, within the declared
times and {SLACK:g} s more, which a busy machine may take: later, and the cell has failed. What was measured
stands beside what is declared. Where the joints are is read at the simulator, not at the driver. When the
fault is over and the link is back nothing moves, though the client goes on sending; what it sends is refused
with a reason. Then the device can be enabled, which moves nothing unless it must be activated first, and
carries out a move.

What is measured here is a simulator with the decelerations of its model, and drivers that are configured
for a busy machine (longer timeouts than their defaults). It says how soon the driver, and the watchdog of
the hardware, act; it does not say how far your arm coasts.
"""

OUTSIDE: Final[Mapping[str, str]] = {
    "onrobot": "tests/onrobot/faults",
    "robotiq-epick": "tests/robotiq/wire/test_epick.py",
    "schunk": "tests/schunk/faults",
    "schunk-fts": "tests/schunk/wire/test_fts.py",
    "weiss-wsg": "tests/weiss_wsg/faults",
}
"""Drivers without a rig: where faults are injected into their simulators instead."""

MATRIX: Final = "## The matrix"
WORLDS: Final = "## Simulated worlds"
_COLUMNS = (
    "Follows",
    "Ran",
    "Failed",
    "Told ms: p50, p99, max",
    "Declared",
    "Stands ms: p50, p99, max",
    "Declared",
    "Farthest",
)


@dataclass
class Tally:
    """What came of one way, in all its activities and rounds. Times in s, ways in rad (m)."""

    ran: int = 0
    failed: list[str] = field(default_factory=list)
    told: list[float] = field(default_factory=list)
    stood: list[float] = field(default_factory=list)
    way: list[float] = field(default_factory=list)


def matrix() -> str:
    """Return the section that follows from the table alone."""
    names = list(RIGS)
    lines = [
        MATRIX,
        "",
        "Ways in which a driver meets a fault, and how many cells these are: one for each activity.",
        "",
    ]
    lines += _table(
        ["Fault", *names],
        (
            [f"{fault.number} {fault.name}", *(_count(RIGS[name], fault.number) for name in names)]
            for fault in FAULTS
        ),
    )
    lines += ["", "### Where a fault cannot be met", ""]
    lines += [
        f"- **{name}**: " + "; ".join(f"{absent.fault} ({absent.why})" for absent in rig.absent)
        for name, rig in RIGS.items()
    ]
    lines += [
        "",
        "### Drivers outside the matrix",
        "",
        "Tests of their own inject faults into their simulators. No times were measured for this page.",
        "",
        *(f"- **{name}**: `{tests}`" for name, tests in OUTSIDE.items()),
    ]
    lines += ["", "### Cells that still fail", "", *_pending()]
    return "\n".join(lines)


def _pending() -> list[str]:
    lines = [
        f"- {rig.name}, {way.fault} {way.name}, {activity}: {finding}"
        for rig in RIGS.values()
        for way in rig.ways
        for activity, finding in way.pending.items()
    ]
    return lines or ["None."]


def _count(rig: type[Rig], fault: str) -> str:
    ways = tuple(way for way in rig.ways if way.fault == fault)
    if not ways:
        return "-"
    return f"{len(ways)} ({len(full(rig.name, ways, rig.activities))})"


def section(rig: type[Rig], tallies: Mapping[tuple[str, str], Tally], how: str) -> str:
    """Return what was measured at one driver."""
    lines = [f"## {rig.name}", "", how, ""]
    lines += _table(
        ["Fault", "Way", *_COLUMNS],
        (_row(way, tallies.get((way.fault, way.name), Tally())) for way in rig.ways),
    )
    return "\n".join(lines)


def _row(way: Way, tally: Tally) -> list[str]:
    return [
        way.fault,
        way.name,
        str(way.follows),
        str(tally.ran),
        str(len(tally.failed)),
        _spread(tally.told),
        f"{1000 * way.within:.0f}" if tally.told else "",
        _spread(tally.stood),
        f"{1000 * way.stands:.0f}" if tally.stood else "",
        f"{max(tally.way):.3f}" if tally.way else "",
    ]


def _spread(values: Sequence[float]) -> str:
    if not values:
        return ""
    found = np.array(values) * 1000.0
    return f"{np.median(found):.0f}, {np.percentile(found, 99):.0f}, {found.max():.0f}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [" | ".join(head), "|".join(["---"] * len(head)), *(" | ".join(row) for row in rows)]
    return [f"| {line} |" for line in lines]


def parts(page: str) -> dict[str, str]:
    """Return the sections of a page by their headings."""
    found = re.split(r"^(?=## )", page, flags=re.MULTILINE)[1:]
    return {text.partition("\n")[0]: text.strip() for text in found}


def compose(old: str, measured: Mapping[str, str]) -> str:
    """Return the page: the matrix, the sections that were measured, and the others of `old` as they were."""
    before = parts(old)
    sections = [matrix()]
    for name in RIGS:
        heading = f"## {name}"
        sections.append(
            measured.get(name) or before.get(heading) or f"{heading}\n\nNot measured yet."
        )
    sections.append(before.get(WORLDS) or f"{WORLDS}\n\nNot run yet.")
    return "\n\n".join([INTRODUCTION.strip(), *sections]) + "\n"


def with_worlds(old: str, section: str) -> str:
    """Return the page with another section about simulated worlds."""
    others = re.split(rf"^{WORLDS}$.*?(?=^## |\Z)", old, maxsplit=1, flags=re.MULTILINE | re.DOTALL)
    return (
        "\n\n".join(each.strip() for each in (others[0], section, *others[1:]) if each.strip())
        + "\n"
    )
