"""Time from ``crtk-driver ur --sim`` to the first measured_js in a subscriber that is already there."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench import processes
from bench.recorded_node import MILESTONES
from bench.recording import load
from bench.report import options, show

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


def run_once(command: Sequence[str], records: Path) -> tuple[float, float]:
    """Start the driver; return when (monotonic s) that was and when the first message was heard."""
    with processes.client(records, "--topics", "measured_js") as client:
        processes.wait_up(client)
        time.sleep(SETTLE)
        begin = time.monotonic()
        with processes.running([*command, *ARGUMENTS], records):
            return begin, processes.wait_ready(client)


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", runs=(5, "of the plain command, and as many for the phases"))
    totals: list[float] = []
    phases: list[list[float]] = []
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        for _ in range(given.runs):
            begin, heard = run_once(processes.CRTK_DRIVER, records)
            totals.append(heard - begin)
            begin, heard = run_once(processes.module("bench.recorded_node"), records)
            reached = dict(load(records, "milestones").tolist())
            marks = [begin, *(reached[float(i)] for i in range(len(MILESTONES))), heard]
            phases.append(np.diff(marks).tolist())
    rows = [
        [label, *(f"{f(values):.2f}" for f in (np.median, np.min, np.max))]
        for label, values in (
            ("crtk-driver ur --sim to first measured_js", np.array(totals)),
            *(
                (f"  until {label}", np.array(values))
                for label, values in zip(
                    [*(_LABELS[name] for name in MILESTONES), "first measured_js heard"],
                    zip(*phases, strict=True),
                    strict=True,
                )
            ),
        )
    ]
    show(
        f"Start, {given.runs} runs",
        ("what", "median s", "min s", "max s"),
        rows,
        ["The phases are of runs of their own, with a note of the time at each milestone."],
    )


if __name__ == "__main__":
    main()
