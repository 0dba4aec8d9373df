"""Control of a UR arm through ur-rtde in its child process beside our own control program, in one run.

Latency: from before `servo_jp` in plain Python until the goal that the simulated controller's servoj gives to
the arm is there, or past it, and until the arm is (target_q): of the lookahead, which smooths a stream, our
program takes most itself, and servoj all of ur-rtde's. Jitter: by how much the time between two places of the
arm differs from the time between the commands to go there. CPU: while commands
are streamed, of the driver and of its child. Enable: from the command to ENABLED, the first time after the
start and again after disable with the power left on. Recovery: from the moment at which it can begin to
ENABLED, after a protective stop that was unlocked, after the controller closed every RTDE connection, and
after the child was killed.
"""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import crtk_drivers
from bench import processes
from bench.recording import load
from bench.report import options, ratio, show
from crtk_sim_backends.process import RunningSim

WAYS = ("ur_rtde", "native")
CHILD = "crtk_driver_ur.library.process"
PATIENCE = 30.0
POLL = 0.001
SAME = 1e-9
"""rad: two positions that are one."""
RUN_UP = 1.0
"""Seconds of the stream in which the arm takes up speed, which are not counted at the arm."""
SETTLE = 1.0
"""Seconds after the start of a stream that are not counted for CPU."""


@dataclass
class Way:
    """What was measured of one way: seconds, and percent of a core."""

    latency: list[float] = field(default_factory=list)
    to_arm: list[float] = field(default_factory=list)
    jitter: list[float] = field(default_factory=list)
    sent: int = 0
    cpu: list[float] = field(default_factory=list)
    child_cpu: list[float] = field(default_factory=list)
    times: dict[str, list[float]] = field(default_factory=dict)

    def took(self, what: str, seconds: float) -> None:
        """Add one duration."""
        self.times.setdefault(what, []).append(seconds)


def stream(control: str, seconds: float, rate: float, way: Way) -> None:
    """Run one segment of streaming."""
    command = [*processes.module("bench.python_front"), "--seconds", str(seconds)]
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        with processes.simulator(records, recorder="bench.recorded_arm") as sim:
            arguments = ["--host", sim.host, "--rate", str(rate), "--control", control]
            with processes.running([*command, *arguments], records) as front:
                processes.wait_ready(front)
                time.sleep(SETTLE)
                child = processes.child_running(front.pid, CHILD)
                before = processes.usage(front.pid), processes.usage(child) if child else None
                time.sleep(max(0.1, seconds - 2.0 * SETTLE))
                way.cpu.append(processes.usage(front.pid).share_since(before[0]))
                if before[1] is not None:
                    way.child_cpu.append(processes.usage(child).share_since(before[1]))
                front.wait(PATIENCE)
        sent = load(records, "front_sent")
        goals, targets = load(records, "goals"), load(records, "targets")
    way.sent += len(sent)
    begin, end = passed(sent, goals)
    way.latency.extend((end - begin) / 1e9)
    begin, end = passed(sent[sent[:, 1] > sent[0, 1] + RUN_UP * 1e9], targets)
    way.to_arm.extend((end - begin) / 1e9)
    way.jitter.extend(np.abs(np.diff(end) - np.diff(begin)) / 1e9)


def passed(sent: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return when commands were sent, and when a ramp of places first was at or past each of them, in ns."""
    reached = np.searchsorted(np.maximum.accumulate(places[:, 0]), sent[:, 0] - SAME)
    came = reached < len(places)
    return sent[came, 1], places[reached[came], 1]


@contextmanager
def driver(sim: RunningSim, control: str) -> Iterator[Any]:
    """A driver in this process, DISABLED."""
    with crtk_drivers.connect(
        "ur", host=sim.host, control=control, power_off_on_disable=False
    ) as arm:
        yield arm


def timed(act: Callable[[], object]) -> float:
    """Return how long `act` takes, s."""
    begin = time.monotonic()
    act()
    return time.monotonic() - begin


def until(test: Callable[[], bool]) -> None:
    """Wait for `test`."""
    deadline = time.monotonic() + PATIENCE
    while not test():
        if time.monotonic() > deadline:
            raise TimeoutError("what a figure waits for does not come")
        time.sleep(POLL)


def start_and_recover(control: str, way: Way) -> None:
    """Take the figures of one fresh driver at a fresh controller."""
    with (
        tempfile.TemporaryDirectory() as folder,
        processes.simulator(Path(folder)) as sim,
        driver(sim, control) as arm,
    ):
        enable = lambda: arm.enable(timeout=PATIENCE)  # noqa: E731
        way.took("enable, first", timed(enable))
        arm.disable(timeout=PATIENCE)
        way.took("enable, again", timed(enable))

        sim.control.inject("protective_stop")
        until(lambda: arm.operating_state().state == "FAULT")
        arm.unlock_protective_stop(timeout=PATIENCE)
        way.took("recovery, protective stop", timed(enable))

        def closed() -> None:
            sim.control.inject("disconnect", port="rtde")
            until(lambda: arm.operating_state().state == "FAULT")
            until(lambda: arm.operating_state().state == "DISABLED")
            enable()

        way.took("recovery, RTDE closed", timed(closed))
        child = processes.child_running(os.getpid(), CHILD)
        if child:

            def killed() -> None:
                os.kill(child, signal.SIGKILL)
                until(lambda: arm.operating_state().state == "FAULT")
                enable()

            way.took("recovery, child killed", timed(killed))


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "",
        seconds=(30.0, "of streaming each way"),
        segments=(3, "into which they are split"),
        rate=(250.0, "servo commands a second"),
        starts=(5, "of the driver each way"),
    )
    ways = {name: Way() for name in WAYS}
    for _ in range(given.segments):
        for name, way in ways.items():
            stream(name, given.seconds / given.segments, given.rate, way)
    for _ in range(given.starts):
        for name, way in ways.items():
            start_and_recover(name, way)

    def percentiles(values: list[float]) -> tuple[float, ...]:
        return tuple(1e3 * float(np.percentile(values, p)) for p in (50.0, 99.0, 100.0))

    measured: dict[str, dict[str, float]] = {}
    for name, way in ways.items():
        found = measured[name] = {}
        for what, values in (
            ("latency to servoj", way.latency),
            ("latency to target_q", way.to_arm),
            ("jitter of target_q", way.jitter),
        ):
            for share, value in zip(("p50", "p99", "max"), percentiles(values), strict=True):
                found[f"{what} {share}, ms"] = value
        found["not at the arm at the end, %"] = 100.0 * (1.0 - len(way.latency) / way.sent)
        found["CPU of the driver, % of a core"] = float(np.mean(way.cpu))
        found["CPU of its child, % of a core"] = (
            float(np.mean(way.child_cpu)) if way.child_cpu else 0.0
        )
        for what, durations in way.times.items():
            found[f"{what}, ms"] = 1e3 * float(np.median(durations))
    theirs, ours = measured["ur_rtde"], measured["native"]
    rows = [
        [
            what,
            f"{value:.2f}",
            f"{ours[what]:.2f}" if what in ours else "-",
            ratio(ours[what], value) if what in ours else "-",
        ]
        for what, value in theirs.items()
    ]
    show(
        f"UR control, servo_jp at {given.rate:g} Hz, {given.seconds:g} s each way",
        ("what", "ur_rtde", "native", "native / ur_rtde"),
        rows,
        [
            "A command that a newer one replaced within a cycle is at the arm when that one is.",
            "Of the lookahead all but 0.03 s passes in our program, before servoj; of ur_rtde's all in it.",
            f"Durations are medians of {given.starts} starts; recovery after a protective stop begins "
            "when it is unlocked.",
        ],
    )


if __name__ == "__main__":
    main()
