"""Time from ``crtk-driver ur --sim`` to the first measured_js in a subscriber that is already there, beside a
bare rclpy publisher; and ``crtk-driver --help`` and ``list`` beside ``import typer``.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench import processes
from bench.recorded_node import MILESTONES
from bench.recording import load
from bench.report import options, ratio, show

ARGUMENTS = ("ur", "--ns", processes.NAMESPACE, "--sim", "--log-level", "warning")

SETTLE = 1.0
"""Seconds that the subscriber exists before the driver is started."""

_LABELS = {
    "interpreter": "Python started",
    "imports": "the command imported",
    "simulator": "simulator ready, device made",
    "opened": "ROS loaded beside that",
    "node": "ROS node made",
    "connected": "connected to the controller",
    "sample": "first sample",
}


LISTS = {
    "python -c 'import typer'": [sys.executable, "-c", "import typer"],
    "crtk-driver --help": [*processes.CRTK_DRIVER, "--help"],
    "crtk-driver list": [*processes.CRTK_DRIVER, "list"],
}
"""Commands that end by themselves; the first is the peer of the others."""


def started(command: Sequence[str], records: Path) -> tuple[float, float]:
    """Start what publishes; return when (monotonic s) that was and when the first message was heard."""
    with processes.client(records, "--topics", "measured_js") as client:
        processes.wait_up(client)
        time.sleep(SETTLE)
        begin = time.monotonic()
        with processes.running(command, records):
            return begin, processes.wait_ready(client)


def ended(command: Sequence[str]) -> float:
    """Run a command and return how long it took (s)."""
    begin = time.monotonic()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=processes.ROOT)
    return time.monotonic() - begin


def phases_of(records: Path, begin: float) -> list[float]:
    """Return how long after `begin` each milestone was reached (s); not a number if it was not."""
    reached = dict(load(records, "milestones").tolist())
    return [reached.get(float(i), np.nan) - begin for i in range(len(MILESTONES))]


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", runs=(10, "of each command"))
    lists: dict[str, list[float]] = {name: [] for name in LISTS}
    totals: list[float] = []
    bare: list[float] = []
    phases: list[list[float]] = []
    publisher = [*processes.module("bench.bare_publisher"), "--namespace", processes.NAMESPACE]
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        for _ in range(given.runs):
            for name, command in LISTS.items():
                lists[name].append(ended(command))
            begin, heard = started([*publisher, "--rate", "100"], records)
            bare.append(heard - begin)
            begin, heard = started([*processes.CRTK_DRIVER, *ARGUMENTS], records)
            totals.append(heard - begin)
            begin, heard = started([*processes.module("bench.recorded_node"), *ARGUMENTS], records)
            phases.append([*phases_of(records, begin), heard - begin])
    names = [*(_LABELS[name] for name in MILESTONES), "first measured_js heard"]
    waits = {
        f"  until {name}": each for name, each in zip(names, zip(*phases, strict=True), strict=True)
    }
    typer, *_ = lists.values()
    rows = [
        *(_row(name, values, typer) for name, values in lists.items()),
        _row("bare rclpy publisher to first message", bare, bare),
        _row("crtk-driver ur --sim to first measured_js", totals, bare),
        *(_row(name, values, bare) for name, values in waits.items()),
    ]
    show(
        f"Start, {given.runs} runs",
        ("what", "median s", "min s", "max s", "over the peer"),
        rows,
        [
            "The phases are of runs of their own, with a note of the time at each milestone.",
        ],
    )


def _row(name: str, values: Sequence[float], peer: Sequence[float]) -> list[str]:
    found = [np.nanmedian(values), np.nanmin(values), np.nanmax(values)]
    return [
        name,
        *(f"{value:.2f}" for value in found),
        ratio(float(found[0]), float(np.median(peer))),
    ]


if __name__ == "__main__":
    main()
