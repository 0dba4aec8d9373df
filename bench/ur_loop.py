"""UR at 500 Hz: the I/O loop of the driver beside a bare loop over ur-rtde.

The driver is ENABLED and publishes measured_js, setpoint_js, measured_cp, setpoint_cp, measured_cv and
measured_cf at 500 Hz to one subscriber process that reads them all. The bare loop reads the same six things
from the same kind of simulator and publishes nothing. Both run alternately, never at the same time.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench import processes
from bench.recording import load
from bench.report import options, ratio, show, spread

RATE = 500.0
LATE = 0.004
SETTLE = 1.0
"""Seconds after the start that are not counted."""


@dataclass
class Loop:
    """What was measured of one of the two loops, over all its segments."""

    periods: list[float] = field(default_factory=list)
    cpu: dict[str, list[float]] = field(default_factory=dict)

    def take_cycles(self, times: np.ndarray, begin: float, end: float) -> None:
        """Add the cycles of a segment."""
        self.periods.extend(np.diff(times[(times >= begin) & (times <= end)]))

    def take_cpu(self, name: str, share: float) -> None:
        """Add the CPU share of a process in a segment."""
        self.cpu.setdefault(name, []).append(share)

    @property
    def rate(self) -> float:
        """Cycles a second."""
        return len(self.periods) / sum(self.periods)

    @property
    def late(self) -> float:
        """Percentage of cycles that took longer than `LATE`."""
        return 100.0 * float(np.mean(np.array(self.periods) > LATE))


def measure_driver(seconds: float, loop: Loop) -> dict[str, float]:
    """Run one segment of the driver; return messages a second by topic number."""
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        with (
            processes.simulator(records) as sim,
            processes.driver(sim, records) as node,
            processes.client(records, "--enable") as client,
        ):
            processes.wait_ready(client)
            time.sleep(SETTLE)
            watched = {**processes.pids(node, sim), "subscriber": client.pid}
            before = {name: processes.usage(pid) for name, pid in watched.items()}
            begin = time.monotonic()
            heard_from = time.time_ns()
            time.sleep(seconds)
            end = time.monotonic()
            heard_until = time.time_ns()
            for name, pid in watched.items():
                loop.take_cpu(name, processes.usage(pid).share_since(before[name]))
        loop.take_cycles(load(records, "cycles")[:, 0], begin, end)
        heard = load(records, "client_heard")
    heard = heard[(heard[:, 2] >= heard_from) & (heard[:, 2] <= heard_until)]
    first = heard[heard[:, 0] == 0]
    return {
        "messages": len(heard) / seconds,
        "fresh": len(np.unique(first[:, 1])) / seconds,
    }


def measure_bare(seconds: float, loop: Loop) -> None:
    """Run one segment of the bare loop."""
    command = [*processes.module("bench.bare_ur_rtde"), "--seconds", str(seconds + 2.0 * SETTLE)]
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        with (
            processes.simulator(records) as sim,
            processes.running([*command, "--host", sim.host], records) as bare,
        ):
            processes.wait_ready(bare)
            time.sleep(SETTLE)
            watched = {"node": bare.pid, "simulator": sim.pid}
            before = {name: processes.usage(pid) for name, pid in watched.items()}
            begin = time.monotonic()
            time.sleep(seconds)
            end = time.monotonic()
            for name, pid in watched.items():
                loop.take_cpu(name, processes.usage(pid).share_since(before[name]))
            bare.wait(processes.STOP_TIMEOUT)
        loop.take_cycles(load(records, "bare")[:, 0], begin, end)


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "", seconds=(60.0, "of each loop"), segments=(4, "into which they are split")
    )
    ours, bare, messages = Loop(), Loop(), []
    for _ in range(given.segments):
        messages.append(measure_driver(given.seconds / given.segments, ours))
        measure_bare(given.seconds / given.segments, bare)
    rows = [
        [
            name,
            f"{loop.rate:.2f}",
            f"{loop.late:.3f}",
            *spread(loop.periods, 1e3, 2),
            *(
                f"{np.nanmean(loop.cpu[part]):.1f}" if part in loop.cpu else "-"
                for part in ("node", "control process", "subscriber", "simulator")
            ),
        ]
        for name, loop in (("driver, publishing", ours), ("bare ur-rtde loop", bare))
    ]
    last_row = [
        "ratio",
        ratio(ours.rate, bare.rate),
        ratio(ours.late, bare.late),
        ratio(float(np.median(ours.periods)), float(np.median(bare.periods))),
        ratio(float(np.percentile(ours.periods, 99)), float(np.percentile(bare.periods, 99))),
        ratio(max(ours.periods), max(bare.periods)),
        ratio(float(np.mean(ours.cpu["node"])), float(np.mean(bare.cpu["node"]))),
    ]
    columns = ("loop", "Hz", "late %", "p50 ms", "p99 ms", "max ms")
    cpu = ("CPU % node", "control", "subscr.", "sim.")
    heard = np.mean([each["messages"] for each in messages])
    fresh = np.mean([each["fresh"] for each in messages])
    show(
        f"UR I/O loop at {RATE:g} Hz, {given.seconds:g} s each in {given.segments} segments",
        (*columns, *cpu),
        [*rows, [*last_row, "", "", ""]],
        [
            f"late: more than {1e3 * LATE:g} ms between two cycles. Targets: 500 Hz within 0.1 % "
            f"({abs(ours.rate / RATE - 1.0) * 100.0:.3f} %), late under 0.5 %.",
            f"The subscriber heard {heard:.0f} messages a second (6 x 500 sent), "
            f"{fresh:.0f} of 500 samples in measured_js.",
        ],
    )


if __name__ == "__main__":
    main()
