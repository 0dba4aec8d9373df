"""UR at 500 Hz, nobody listening: the driver's I/O thread beside a loop that only reads and decodes.

Both run in this process against the same simulator, alternately: the driver ENABLED and idle, in plain
Python; and a thread that reads and decodes the state packages (`rtde.stream`) and does nothing else with
them. CPU is that of the one thread, as the scheduler counts it.
"""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Callable
from pathlib import Path

import crtk_drivers
from bench.report import options, show
from crtk_driver_ur.rtde.stream import RtdeStream
from crtk_sim_backends import process
from crtk_sim_backends.process import RunningSim

RATE = 500.0
SETTLE = 1.0
THREADS = Path("/proc/self/task")


def cpu(thread: int) -> float:
    """Return the seconds that a thread of this process has run."""
    return int((THREADS / str(thread) / "schedstat").read_text().split()[0]) * 1e-9


def measured(thread: int, seconds: float) -> float:
    """Return the share of a core that a thread takes in so many seconds."""
    time.sleep(SETTLE)
    begin, before = time.monotonic(), cpu(thread)
    time.sleep(seconds)
    return (cpu(thread) - before) / (time.monotonic() - begin)


def of_driver(sim: RunningSim, seconds: float) -> float:
    """Return the share of the driver's I/O thread."""
    with crtk_drivers.connect("ur", host=sim.host) as arm:
        arm.enable()
        name = f"io {arm.engine.device.bus}"
        (thread,) = (each.native_id for each in threading.enumerate() if each.name == name)
        assert thread is not None
        return measured(thread, seconds)


def of_reader(sim: RunningSim, seconds: float) -> float:
    """Return the share of a thread that only reads and decodes."""
    stream = RtdeStream(sim.host)
    stream.open(time.monotonic() + 5.0)
    ended = threading.Event()

    def read() -> None:
        while not ended.is_set():
            stream.receive(time.monotonic() + 0.1)

    thread = threading.Thread(target=read, name="reader")
    thread.start()
    try:
        assert thread.native_id is not None
        return measured(thread.native_id, seconds)
    finally:
        ended.set()
        thread.join()
        stream.close()


LOOPS: dict[str, Callable[[RunningSim, float], float]] = {
    "I/O thread of the driver": of_driver,
    "only read and decoded": of_reader,
}


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(4.0, "of each turn"), turns=(5, "of each loop"))
    shares: dict[str, list[float]] = {name: [] for name in LOOPS}
    with process.spawn("crtk_sim_backends.ur", ["--realtime"]) as sim:
        for _ in range(given.turns):
            for name, loop in LOOPS.items():
                shares[name].append(loop(sim, given.seconds))
    middle = {name: statistics.median(of) for name, of in shares.items()}
    peer = middle["only read and decoded"]
    rows = [
        [name, f"{100 * value:.1f}", f"{1e6 * value / RATE:.0f}", f"{value / peer:.2f}"]
        for name, value in middle.items()
    ]
    columns = ("thread", "CPU % of a core", "us a cycle", "ratio")
    show("UR I/O thread at 500 Hz, nobody listening", columns, rows, ["Medians. Aim: 8 %, 1.5."])


if __name__ == "__main__":
    main()
