"""The simulated UR controller: how even its periods are, what it costs, how soon and how fast it runs.

Idle and with ur-rtde's servoJ at 500 Hz, simulator and client together on one core, with and without a
neighbour that burns the other core; with the option `realtime` too, where the system permits that. Then the
start, ten controllers on the machine, and the controller's time against real time.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench import processes
from bench.recording import DIRECTORY, load
from bench.report import options, show, spread
from crtk_driver_ur.rtde.stream import RtdeStream
from crtk_sim_backends import process
from crtk_sim_backends.process import RunningSim
from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.controller import Controller
from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.pace import LATE

SETTLE = 1.0
"""Seconds after the start that are not counted."""
TIMEOUT = 20.0
CONTROLLERS = 10
FAST = 100.0
"""Times real time that are asked for: more than any machine does."""
CIRCLE = (
    "def circle():\n  t = 0\n  while (True):\n    q = [0.02 * sin(t), -1.57, 1.57, -1.57, -1.57, 0]\n"
    "    servoj(q, 0, 0, 0.002, 0.1, 300)\n    t = t + 0.002\n  end\nend\n"
)


@contextlib.contextmanager
def neighbour(core: int | None, records: Path) -> Iterator[None]:
    """Burn a core, unless it is None."""
    if core is None:
        yield
        return
    with (
        processes.on_core(core),
        processes.running([sys.executable, "-c", "while True: pass"], records),
    ):
        yield


@contextlib.contextmanager
def servo_client(sim: RunningSim, records: Path) -> Iterator[int]:
    """Run ur-rtde's servoJ at 500 Hz; yield its process id."""
    command = [*processes.module("bench.servo_client"), "--host", sim.host]
    with processes.running(command, records) as client:
        processes.wait_ready(client)
        yield client.pid


def realtime_permitted() -> bool:
    """Whether a process may have real-time priority here."""
    policy = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, policy, os.sched_param(0))
    return True


class Segment:
    """One run of the loop: delays (s) of its periods, CPU of simulator and client (% of a core)."""

    def __init__(
        self, seconds: float, cores: Sequence[int], *, servo: bool, realtime: bool
    ) -> None:
        burning = cores[1] if len(cores) > 1 else None
        with tempfile.TemporaryDirectory() as folder, neighbour(burning, Path(folder)):
            records = Path(folder)
            os.environ[DIRECTORY] = folder
            flags = ["--realtime"] if realtime else []
            with contextlib.ExitStack() as stack:
                with processes.on_core(cores[0]):
                    sim = stack.enter_context(process.spawn("bench.recorded_sim", flags))
                    watched = [sim.pid]
                    if servo:
                        watched.append(stack.enter_context(servo_client(sim, records)))
                time.sleep(SETTLE)
                before = [processes.usage(pid) for pid in watched]
                begin = time.monotonic()
                time.sleep(seconds)
                end = time.monotonic()
                after = [processes.usage(pid) for pid in watched]
                self.skipped = sim.control.status()["statistics"]["skipped"]
            noted = load(records, "delays")
        self.cpu = [late.share_since(early) for early, late in zip(before, after, strict=True)]
        within = (noted[:, 0] >= begin) & (noted[:, 0] <= end)
        self.delays: NDArray[np.float64] = np.maximum(noted[within, 1], 0.0)

    def row(self, name: str) -> list[str]:
        """Return it as a row of the table."""
        late = self.delays > LATE
        return [
            name,
            str(self.delays.size),
            f"{100.0 * float(late.mean()):.2f}",
            *spread(self.delays, 1e3, 2),
            str(self.skipped),
            *(f"{share:.1f}" for share in self.cpu),
            *["-"] * (2 - len(self.cpu)),
        ]


def show_loop(seconds: float) -> None:
    """Show how even the periods are."""
    cores = sorted(os.sched_getaffinity(0))
    rows = []
    places = [("", cores[:1]), (", neighbour", cores[:2])][: len(cores)]
    for realtime in (False, True) if realtime_permitted() else (False,):
        for beside, used in places:
            for servo in (False, True):
                name = ("servo" if servo else "idle") + beside + (", realtime" if realtime else "")
                segment = Segment(seconds, used, servo=servo, realtime=realtime)
                rows.append(segment.row(name))
    columns = ("500 Hz", "periods", "late %", "p50 ms", "p99 ms", "max ms", "left out", "CPU %")
    show(
        f"UR simulator and client on one core, {seconds:g} s each",
        (*columns, "client"),
        rows,
        [
            f"late: more than {1e3 * LATE:g} ms. Servo: ur-rtde's servoJ, in a process of its own on "
            "the same core. Neighbour: a process that burns the other core."
        ],
    )


def time_start(**changes: Any) -> tuple[float, float]:
    """Return the seconds from the start to a ready simulator, and from there to the first package."""
    begin = time.monotonic()
    with SIM.spawn(**changes) as sim:
        ready = time.monotonic()
        stream = RtdeStream(sim.host)
        stream.open(ready + TIMEOUT)
        assert stream.receive(ready + TIMEOUT) is not None
        heard = time.monotonic()
        stream.close()
    return ready - begin, heard - ready


def show_start(runs: int) -> None:
    """Show how soon it runs."""
    ready, heard = np.array([time_start() for _ in range(runs)]).T
    rows = [
        ["started to ports bound", *spread(ready, 1e3, 1)],
        ["ports bound to first RTDE package", *spread(heard, 1e3, 1)],
        ["both", *spread(ready + heard, 1e3, 1)],
    ]
    show(f"Start, {runs} runs", ("what", "p50 ms", "p99 ms", "max ms"), rows)


class Listener(threading.Thread):
    """Counts the packages of one controller."""

    def __init__(self, sim: RunningSim, frequency: float) -> None:
        super().__init__(daemon=True)
        self.stream = RtdeStream(sim.host, frequency=frequency)
        self.stream.open(time.monotonic() + TIMEOUT)
        self.ending = threading.Event()

    def run(self) -> None:
        """Receive until it is ended."""
        while not self.ending.is_set():
            self.stream.receive(time.monotonic() + 0.5)

    def end(self) -> None:
        """End it."""
        self.ending.set()
        self.join()
        self.stream.close()


@contextlib.contextmanager
def heard(sims: Sequence[RunningSim], frequency: float) -> Iterator[None]:
    """Listen to every simulator, in a thread each."""
    listeners: list[Listener] = []
    try:
        for sim in sims:
            listeners.append(Listener(sim, frequency))
            listeners[-1].start()
        yield
    finally:
        for listener in listeners:
            listener.end()


def show_many(seconds: float) -> None:
    """Show many controllers at 125 Hz on this machine, each with one RTDE client."""
    with contextlib.ExitStack() as stack:
        sims = [stack.enter_context(SIM.spawn(model="ur5")) for _ in range(CONTROLLERS)]
        stack.enter_context(heard(sims, 125.0))
        time.sleep(SETTLE)
        before = [(sim.control.status(), processes.usage(sim.pid)) for sim in sims]
        time.sleep(seconds)
        after = [(sim.control.status(), processes.usage(sim.pid)) for sim in sims]
    late, rates, cpu = [], [], []
    for (first, used), (last, using) in zip(before, after, strict=True):
        was, now = first["statistics"], last["statistics"]
        ticks = now["ticks"] - was["ticks"]
        late.append(100.0 * (now["late"] - was["late"]) / ticks)
        rates.append(ticks / (using.at - used.at))
        cpu.append(using.share_since(used))
    rows = [
        ["periods a second", *(f"{f(rates):.2f}" for f in (np.median, min, max))],
        [f"late over {1e3 * LATE:g} ms, %", *(f"{f(late):.2f}" for f in (np.median, min, max))],
        ["CPU of each, % of a core", *(f"{f(cpu):.1f}" for f in (np.median, min, max))],
    ]
    show(
        f"{CONTROLLERS} controllers at 125 Hz, each with an RTDE client, {seconds:g} s",
        ("of the controllers", "median", "min", "max"),
        rows,
        [f"CPU of all: {sum(cpu):.0f} % of a core."],
    )


def without_sockets(seconds: float, *, servo: bool) -> float:
    """Return the speed of the controller alone, in times real time."""
    controller = Controller(MODELS["ur5e"], (5, 12, 4, 0))
    if servo:
        controller.run_script(CIRCLE)
    begin = time.monotonic()
    while (now := time.monotonic()) < begin + seconds:
        for _ in range(100):
            controller.tick()
    return controller.time / (now - begin)


def with_sockets(seconds: float, frequency: float | None) -> float:
    """Return the speed of the whole simulator with an RTDE client at that rate, or with none."""
    with contextlib.ExitStack() as stack:
        sim = stack.enter_context(SIM.spawn(speed=FAST))
        if frequency is not None:
            stack.enter_context(heard([sim], frequency))
        time.sleep(SETTLE)
        begin, first = time.monotonic(), sim.control.status()["time"]
        time.sleep(seconds)
        end, last = time.monotonic(), sim.control.status()["time"]
    return float((last - first) / (end - begin))


def show_speed(seconds: float) -> None:
    """Show how fast the controller's time can pass."""
    found = {
        "controller alone, idle": without_sockets(seconds, servo=False),
        "controller alone, a program with servoj": without_sockets(seconds, servo=True),
        "simulator, no client": with_sockets(seconds, None),
        "simulator, RTDE client at 125 Hz": with_sockets(seconds, 125.0),
        "simulator, RTDE client at 500 Hz": with_sockets(seconds, 500.0),
    }
    show(
        f"The controller's time, {seconds:g} s each",
        ("500 Hz controller", "times real time"),
        [[name, f"{value:.1f}"] for name, value in found.items()],
        ["Rates of the clients are in the controller's time."],
    )


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "",
        seconds=(8.0, "of each loop, and of the ten controllers"),
        runs=(15, "of the start"),
        speed_seconds=(4.0, "of each speed"),
    )
    show_loop(given.seconds)
    show_start(given.runs)
    show_many(given.seconds)
    show_speed(given.speed_seconds)


if __name__ == "__main__":
    main()
