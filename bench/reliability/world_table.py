"""The section of docs/reliability.md about simulated worlds: a row for each device, until its next run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from bench.reliability.page import WORLDS, parts
from crtk_drivers.testing.world.troubles import FAULTS, WEATHER

_TEXT: Final = """\
Drivers at their simulators, each in a world in which one seed decides what the user does, which fault comes
when, and which thread goes on. Judges compare what the driver promises with what is so in the simulator:
where joints are, what acts on a sensor, what force a haptic device exerts, whether a pedal is pressed.
`python -m bench.world --hours 8 --write` searches with new seeds and writes this section. A finding is one
kind of broken promise in one scenario."""
_FIRST: Final = ("Device", "Date", "Commit")
_IN_ALL: Final = "**in all**"
_SUMMED: Final = ("Worlds", "Virtual h", *FAULTS, "Bad weather", "Findings open")
_COLUMNS: Final = (*_FIRST, *_SUMMED)


@dataclass
class Tally:
    """What came of one device.

    Attributes:
        worlds: how many were run.
        virtual, cpu: s that passed in them, and of the processor.
        struck: faults and bad weather, by kind.
        kinds: scenario and kind of each finding.
    """

    worlds: int = 0
    virtual: float = 0.0
    cpu: float = 0.0
    struck: Counter[str] = field(default_factory=Counter)
    kinds: set[tuple[str, str]] = field(default_factory=set)

    @property
    def faults(self) -> int:
        """How many came, bad weather apart."""
        return sum(self.struck[kind] for kind in FAULTS)

    def row(self, device: str, date: str, commit: str) -> dict[str, str]:
        """Return the row of the table, by column."""
        return {
            "Device": device,
            "Date": date,
            "Commit": commit,
            "Worlds": str(self.worlds),
            "Virtual h": f"{self.virtual / 3600.0:.2f}",
            **{kind: str(self.struck[kind]) for kind in FAULTS},
            "Bad weather": str(sum(self.struck[kind] for kind in WEATHER)),
            "Findings open": str(len(self.kinds)),
        }


def section(
    old: str, tallies: Mapping[str, Tally], date: str, commit: str, machine_line: str
) -> str:
    """Return the section: rows of devices that were run, and those of `old` of the others.

    Args:
        old: the page as it is.
        tallies: of the devices that were run.
        date, commit: of the run.
        machine_line: where it ran.
    """
    rows = _rows(parts(old).get(WORLDS, ""))
    rows |= {name: tally.row(name, date, commit) for name, tally in tallies.items()}
    rows.pop(_IN_ALL, None)
    rows = dict(sorted(rows.items()))
    in_all = dict.fromkeys(_FIRST, "") | {"Device": _IN_ALL}
    for column in _SUMMED:
        total = sum(float(row.get(column, "0") or "0") for row in rows.values())
        in_all[column] = f"{total:.2f}" if column == "Virtual h" else f"{total:.0f}"
    table = [
        list(_COLUMNS),
        ["---"] * len(_COLUMNS),
        *([row.get(column, "") for column in _COLUMNS] for row in (*rows.values(), in_all)),
    ]
    lines = [f"| {' | '.join(row)} |" for row in table]
    return "\n".join([WORLDS, "", _TEXT, "", f"Last run: {machine_line}.", "", *lines])


def _rows(text: str) -> dict[str, dict[str, str]]:
    """Return the rows of a section by device, each by column."""
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    if not cells:
        return {}
    head, _, *rest = cells
    return {row[0]: dict(zip(head, row, strict=True)) for row in rest}
