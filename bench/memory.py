"""Memory of node, control process and simulator at 500 Hz, ENABLED, six topics heard by one subscriber."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from bench import processes
from bench.report import options, show

MEGABYTE = 1e6


def measure(seconds: float, every: float) -> dict[str, list[tuple[float, float]]]:
    """Return, by process, pairs of time (s from the start) and resident memory (MB)."""
    resident: dict[str, list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        with (
            processes.simulator(records, recorded=False) as sim,
            processes.driver(sim, records, recorded=False) as node,
            processes.client(records, "--enable", "--quiet") as client,
        ):
            processes.wait_ready(client)
            begin = time.monotonic()
            while (elapsed := time.monotonic() - begin) <= seconds:
                # Looked up each time: a control process that was lost is replaced by another.
                watched = {**processes.pids(node, sim), "subscriber": client.pid}
                for name, pid in watched.items():
                    used = processes.usage(pid)
                    if used is not processes.GONE:
                        resident.setdefault(name, []).append((elapsed, used.rss / MEGABYTE))
                time.sleep(every)
    return resident


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "",
        seconds=(600.0, "of running"),
        warmup=(60.0, "seconds before the slope is taken"),
        every=(2.0, "seconds between two looks"),
    )
    rows = []
    for name, pairs in measure(given.seconds, given.every).items():
        times, found = np.array(pairs).T
        warm = times >= min(given.warmup, given.seconds / 2.0)
        slope, _ = np.polyfit(times[warm] / 60.0, found[warm] * 1000.0, 1)
        shown = (found[0], found[warm][0], found[-1], found.max())
        rows.append([name, *(f"{value:.1f}" for value in shown), f"{slope:+.1f}"])
    show(
        f"Resident memory over {given.seconds:g} s at 500 Hz",
        ("process", "start MB", f"{given.warmup:g} s MB", "end MB", "max MB", "slope kB/min"),
        rows,
        [f"slope: least squares over what follows the first {given.warmup:g} s."],
    )


if __name__ == "__main__":
    main()
