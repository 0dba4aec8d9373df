"""The processor is taken from a UR driver, from its simulated controller, or from both, for a while.

Each is stopped (SIGSTOP) and goes on (SIGCONT), at moments that do not repeat, while the arm is streamed
positions or velocities, or moves. A real controller has a processor of its own: what happens when the driver
alone stands still says how strict driver and controller are; what happens when the controller stands still is
what a busy machine does to a simulation, and no robot does.

Told are, of so many stalls, those after which the arm was stopped protectively (with the controller's code),
and those after which the driver was not ENABLED any more, with what it says.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from random import Random

import crtk_drivers
from bench import processes
from bench.report import show
from crtk_drivers.errors import CrtkError
from crtk_sim_backends.process import RunningSim

WAYS = ("native", "ur_rtde")
ACTIVITIES = ("servo_jp", "servo_jv", "servo_cv", "move_jp")
WHO = ("driver", "simulator", "both")
MILLISECONDS = (5, 20, 50, 100, 200)
RATE = 250.0
AMPLITUDE = 0.3
OMEGA = math.pi
BETWEEN = (0.25, 0.45)
"""Seconds from one stall to the next."""
CHILD = "crtk_driver_ur.library.process"
PATIENCE = 20.0
PROTECTIVE_STOP = 3


def client(host: str, control: str, activity: str) -> None:
    """Move until something stops it; what that was is the last line."""
    with crtk_drivers.connect("ur", host=host, control=control) as arm:
        arm.enable(timeout=PATIENCE)
        start = arm.measured_js().position.copy()
        goal, velocity, twist = start.copy(), 0.0 * start, 0.0 * start
        due, phase = time.monotonic(), 0.0
        print("ready", due, flush=True)
        while arm.operating_state().state == "ENABLED":
            try:
                if activity == "move_jp":
                    goal[0] = start[0] + AMPLITUDE * (1.0 if goal[0] <= start[0] else -1.0)
                    arm.move_jp(goal).wait(PATIENCE)
                    continue
                phase += OMEGA / RATE  # it goes on where it was before a stall
                goal[0] = start[0] + AMPLITUDE * (1.0 - math.cos(phase))
                velocity[0] = twist[5] = AMPLITUDE * OMEGA * math.sin(phase)
                stream = {"servo_jp": goal, "servo_jv": velocity, "servo_cv": twist}[activity]
                getattr(arm, activity)(stream)
            except CrtkError as error:
                print("refused:", error.message, flush=True)
                time.sleep(0.2)
                start, phase = arm.setpoint_js().position.copy(), 0.0
            due = max(due + 1.0 / RATE, time.monotonic() - 0.02)
            time.sleep(max(0.0, due - time.monotonic()))
        status = arm.operating_state()
        print(status.state, status.detail, flush=True)


class Pair:
    """A simulator, and a driver in a process of its own that moves its arm."""

    def __init__(self, sim: RunningSim, front: subprocess.Popen[str], control: str) -> None:
        self.sim = sim
        self._front = front
        self._control = control

    def stall(self, who: str, seconds: float) -> None:
        """Take the processor away."""
        stopped = [self.sim.pid] if who != "driver" else []
        if who != "simulator" and self.moves:
            stopped.append(self._front.pid)
            if self._control == "ur_rtde":  # its process is replaced when it falls silent
                stopped.append(processes.child_running(self._front.pid, CHILD))
        for number in (signal.SIGSTOP, signal.SIGCONT):
            for pid in filter(None, stopped):
                with suppress(ProcessLookupError):
                    os.kill(pid, number)
            time.sleep(seconds if number == signal.SIGSTOP else 0.0)

    def stop_code(self) -> str:
        """Return why the controller has stopped the arm protectively; empty if it has not."""
        if self.sim.control.outputs("safety_mode")["safety_mode"] != PROTECTIVE_STOP:
            return ""
        texts = [str(entry["text"]) for entry in self.sim.control.status()["log"]]
        return next((text for text in reversed(texts) if "ErrorMessage" in text), "?")

    @property
    def moves(self) -> bool:
        """Whether the driver still moves the arm."""
        return self._front.poll() is None

    def last_words(self) -> str:
        """Return what the driver said at its end."""
        assert self._front.stdout is not None
        return " / ".join(line.strip() for line in self._front.stdout)


@contextmanager
def pair(control: str, activity: str) -> Iterator[Pair]:
    """Start both."""
    with tempfile.TemporaryDirectory() as folder:
        records = Path(folder)
        with processes.simulator(records, recorded=False) as sim:
            arguments = ["--host", sim.host, "--control", control, "--activity", activity]
            command = [*processes.module("bench.ur_stalls"), *arguments]
            with processes.running(command, records) as front:
                processes.wait_ready(front)
                time.sleep(0.3)
                yield Pair(sim, front, control)


def measure(
    control: str, activity: str, who: str, seconds: float, count: int
) -> tuple[int, int, int, Counter[str]]:
    """Stall so often; how often, protective stops, ends of the driver, and their reasons."""
    random = Random(f"{control} {activity} {who} {seconds}")
    done = stops = ends = 0
    reasons: Counter[str] = Counter()
    while done < count:
        with pair(control, activity) as both:
            while done < count and both.moves:
                time.sleep(random.uniform(*BETWEEN))
                both.stall(who, seconds)
                done += 1
                time.sleep(0.3)
                code = both.stop_code()
                if code:
                    stops += 1
                    reasons[code] += 1
                if code or not both.moves:
                    ends += 1
                    reasons[both.last_words()] += 1
                    break
    return done, stops, ends, reasons


def main() -> None:
    """Measure and print; with --host, be the driver of a measurement."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=10, help="stalls of each kind (default: 10)")
    parser.add_argument("--control", choices=WAYS, action="append", help="only this way")
    parser.add_argument("--activity", choices=ACTIVITIES, action="append", help="only this motion")
    parser.add_argument("--who", choices=WHO, action="append", help="only these processes")
    parser.add_argument("--milliseconds", type=float, action="append", help="only for so long")
    parser.add_argument("--host", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.host:
        client(given.host, given.control[0], given.activity[0])
        return
    rows, notes = [], []
    for control in given.control or WAYS:
        for activity in given.activity or ACTIVITIES:
            for who in given.who or WHO:
                cells = []
                for milliseconds in given.milliseconds or MILLISECONDS:
                    count, stops, ends, reasons = measure(
                        control, activity, who, milliseconds / 1e3, given.count
                    )
                    cells.append(f"{stops}, {ends} / {count}")
                    for reason, times in reasons.items():
                        notes.append(
                            f"{control} {activity} {who} {milliseconds:g} ms, {times}: {reason}"
                        )
                rows.append([f"{control} {activity}, {who}", *cells])
                print(rows[-1], flush=True)
    columns = [f"{value:g} ms" for value in given.milliseconds or MILLISECONDS]
    show(
        "Protective stops, and ends of the driver's control, of so many stalls",
        ("who stands still", *columns),
        rows,
        notes,
    )


if __name__ == "__main__":
    main()
