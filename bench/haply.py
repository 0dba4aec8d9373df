"""A Haply by its service: rate and lateness of samples, CPU, from a command to the force, and to no force.

The service is the simulated one, in its own process on this machine. Beside the driver a bare loop of the
same library (`websockets`, its client of the threading kind): it sends a force, reads the answer, and sleeps.
"""

from __future__ import annotations

import json
import logging
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

from websockets.sync.client import connect

from bench.report import options, ratio, show, spread
from crtk_driver_haply import PLUGIN
from crtk_driver_haply.config import HaplyConfig
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.haply import SIM, RunningSim

RATES = (200.0, 500.0, 1000.0)
FORCE = 0.5
VICTIM = """
import sys, time
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_driver_haply import PLUGIN
from crtk_driver_haply.config import HaplyConfig
session = Session(PLUGIN, HaplyConfig(host=sys.argv[1], port=int(sys.argv[2]), ramp=0.0))
front = LocalDevice(session)
session.start()
while not (session.engine.connected and session.engine.has_sample):
    time.sleep(0.01)
front.enable()
while True:
    front.servo_cf([0.5, 0, 0, 0, 0, 0])
    time.sleep(0.005)
"""


@contextmanager
def driver(sim: RunningSim, rate: float) -> Iterator[LocalDevice]:
    """The driver, ENABLED."""
    config = PLUGIN.sim_config(HaplyConfig(rate=rate, ramp=0.0), sim)
    session = Session(PLUGIN, config)
    front = LocalDevice(session)
    try:
        session.start()
        until(lambda: front.engine.connected and front.engine.has_sample)
        front.enable()
        yield front
    finally:
        front.close()


def until(test: Callable[[], object], timeout: float = 10.0) -> None:
    """Wait until something holds."""
    end = time.monotonic() + timeout
    while not test():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.0005)


def message(force: float) -> str:
    """Return what a bare client sends."""
    commands = {"set_cursor_force": {"values": {"x": force, "y": 0.0, "z": 0.0}}}
    return json.dumps({"inverse3": [{"device_id": "049D", "commands": commands}]})


def by_driver(sim: RunningSim, rate: float, seconds: float) -> tuple[list[float], float]:
    """Return intervals between samples (s), and CPU in percent of a core."""
    stamps: list[float] = []
    with driver(sim, rate) as front:
        front.engine.on_sample = lambda: stamps.append(time.monotonic())
        time.sleep(0.5)
        stamps.clear()
        began, used = time.monotonic(), time.process_time()
        time.sleep(seconds)
        cpu = 100.0 * (time.process_time() - used) / (time.monotonic() - began)
        front.engine.on_sample = None
    return [after - before for before, after in pairwise(stamps)], cpu


def by_hand(sim: RunningSim, rate: float, seconds: float) -> tuple[list[float], float]:
    """Return the same of a bare loop."""
    stamps: list[float] = []
    text = message(0.0)
    with connect(f"ws://{sim.host}:{sim.ports['service']}") as client:
        client.recv()
        began, used = time.monotonic(), time.process_time()
        due = began
        while (now := time.monotonic()) < began + seconds:
            client.send(text)
            json.loads(client.recv())
            stamps.append(time.monotonic())
            due = max(due + 1.0 / rate, now)
            time.sleep(max(0.0, due - time.monotonic()))
        cpu = 100.0 * (time.process_time() - used) / (time.monotonic() - began)
    return [after - before for before, after in pairwise(stamps)], cpu


def felt(sim: RunningSim, send: Callable[[float], object], count: int) -> list[float]:
    """Return the seconds from each command of a stream that changes to the force that the motors exert."""
    found = []
    for number in range(count):
        force = FORCE * (1 + number % 2)
        began = time.monotonic()
        send(force)
        for _ in range(3):
            time.sleep(0.01)
            send(force)
        status = sim.control.status()
        if status["force"][0] == force and status["force_since"] >= began:
            found.append(status["force_since"] - began)
        time.sleep(0.0007 * (number % 7))  # at any time of the driver's cycle
    return found


def driver_felt(sim: RunningSim, rate: float, count: int) -> list[float]:
    """Return that of servo_cf."""
    with driver(sim, rate) as front:
        return felt(sim, lambda force: front.servo_cf([force, 0, 0, 0, 0, 0]), count)


def hand_felt(sim: RunningSim, count: int) -> list[float]:
    """Return that of a bare client."""
    with connect(f"ws://{sim.host}:{sim.ports['service']}") as client:
        client.recv()

        def send(force: float) -> None:
            client.send(message(force))
            client.recv()

        return felt(sim, send, count)


def let_go(sim: RunningSim, began: float) -> float:
    """Return the seconds until no force was exerted."""
    status: dict[str, Any] = {}

    def is_none() -> bool:
        status.update(sim.control.status())
        return not any(status["force"])

    until(is_none)
    return float(status["force_since"] - began)


def streaming(sim: RunningSim, front: LocalDevice) -> Callable[[], None]:
    """Stream a force until what is returned is called."""
    over = threading.Event()

    def stream() -> None:
        while not over.wait(0.005):
            try:
                front.servo_cf([FORCE, 0, 0, 0, 0, 0])
            except Exception:
                return

    thread = threading.Thread(target=stream)
    thread.start()
    until(lambda: any(sim.control.status()["force"]))

    def end() -> None:
        over.set()
        thread.join()

    return end


def ends(sim: RunningSim, count: int) -> dict[str, list[float]]:
    """Return the seconds to no force, and what else is measured, by what ends it."""
    found: dict[str, list[float]] = {
        name: [] for name in ("stream", "disable", "vanishes", "told", "killed")
    }
    for _ in range(count):
        with driver(sim, 500.0) as front:
            end = streaming(sim, front)
            end()
            found["stream"].append(let_go(sim, time.monotonic()))
            end = streaming(sim, front)
            began = time.monotonic()
            front.disable()
            found["disable"].append(let_go(sim, began))
            end()
            front.enable()
            end = streaming(sim, front)
            began = time.monotonic()
            sim.control.inject("vanish")
            found["vanishes"].append(let_go(sim, began))
            until(lambda: str(front.operating_state().state) == "FAULT")
            found["told"].append(time.monotonic() - began)
            end()
            sim.control.clear()
        found["killed"].append(killed(sim))
    return found


def killed(sim: RunningSim) -> float:
    """Return the seconds from the end of a driver's process to no force."""
    where = [sim.host, str(sim.ports["service"])]
    with subprocess.Popen([sys.executable, "-c", VICTIM, *where]) as victim:
        until(lambda: any(sim.control.status()["force"]))
        began = time.monotonic()
        victim.send_signal(signal.SIGKILL)
        return let_go(sim, began)


def main() -> None:
    """Print the tables."""
    given = options(
        __doc__ or "",
        seconds=(5.0, "of each rate"),
        count=(200, "commands"),
        ends=(10, "times that a force ends in each way"),
    )
    logging.disable(logging.ERROR)  # refusals and faults are what is measured
    rows = []
    with SIM.spawn(realtime=True) as sim:
        for rate in RATES:
            ours, cpu = by_driver(sim, rate, given.seconds)
            bare, bare_cpu = by_hand(sim, rate, given.seconds)
            for name, intervals, share in (("driver", ours, cpu), ("bare", bare, bare_cpu)):
                mean = len(intervals) / sum(intervals)
                late = [interval - 1.0 / rate for interval in intervals]
                rows.append(
                    [f"{rate:.0f} Hz, {name}", f"{mean:.1f}", *spread(late, 1e3, 2), f"{share:.0f}"]
                )
            rows[-2].append(ratio(cpu, bare_cpu))
            rows[-1].append("")
        columns = ["", "samples/s", "late p50", "p99", "max ms", "CPU %", "ratio"]
        show("Samples", columns, rows)
        delays = {
            "servo_cf, 500 Hz": driver_felt(sim, 500.0, given.count),
            "servo_cf, 1000 Hz": driver_felt(sim, 1000.0, given.count),
            "bare client": hand_felt(sim, given.count),
        }
        rows = [[name, *spread(found, 1e3, 2), str(len(found))] for name, found in delays.items()]
        show("From a command to the force", ["", "p50", "p99", "max ms", "of"], rows)
        told = {
            "stream": "the stream ends (stream_timeout 50 ms)",
            "disable": "disable",
            "vanishes": "the Inverse3 is unplugged: its motors",
            "told": "the Inverse3 is unplugged: FAULT",
            "killed": "the driver is killed (the service is idle after 100 ms)",
        }
        measured = ends(sim, given.ends)
        rows = [[told[name], *spread(found, 1e3, 1)] for name, found in measured.items()]
        show("To no force", ["", "p50", "p99", "max ms"], rows)


if __name__ == "__main__":
    main()
