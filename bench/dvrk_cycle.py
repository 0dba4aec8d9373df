"""dVRK: readings of an arm a second and what one costs, beside a bare loop that makes the same exchanges.

Both ask the two simulated boards of a PSM, one after the other, and wait for the answer: the bare loop sends
the same bytes again and again, and looks at nothing that comes. "Alone" is the device in a loop, with its
checks, conversions and joint states, but no engine; "driver" is all of it, at the rate that it is asked for.
"Driving" sends currents before it asks, and judges what boards tell: a small effort, to and fro, which the
driver is given by a thread of its own as often as it reads.

    python -m bench.dvrk_cycle
"""

from __future__ import annotations

import contextlib
import itertools
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from bench.report import options, show, spread
from crtk_driver_dvrk import PLUGIN, packets
from crtk_driver_dvrk.config import DvrkConfig
from crtk_driver_dvrk.device import DvrkDevice
from crtk_driver_dvrk.driven import DrivenDevice
from crtk_driver_dvrk.orders import Motor, order
from crtk_driver_dvrk.registers import AXES, QUADLETS
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.errors import CommandRefused
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import RunningSim
from crtk_drivers.samples import vector
from crtk_drivers.session import Session
from crtk_sim_backends.dvrk import SIM

NODES = (0, 1)
BOARDS = (6, 7)
RATES = (200.0, 250.0, 500.0)
GENERATION = 1
"""Of the simulated bus, which nothing resets here."""

NOTE = "CPU is that of the process that asks, for one reading of both boards; the boards are another one."


class Figures(NamedTuple):
    """What came of a loop: seconds of each reading, or between two; CPU s of one reading."""

    times: list[float]
    cpu: float
    seconds: float


def looped(once: Callable[[], object], seconds: float) -> Figures:
    """Do something again and again, as fast as it goes."""
    times: list[float] = []
    began, used = time.perf_counter(), time.process_time()
    end, before = began + seconds, began
    while before < end:
        once()
        now = time.perf_counter()
        times.append(now - before)
        before = now
    return Figures(times, (time.process_time() - used) / len(times), before - began)


PATIENT: dict[str, Any] = {"reply_timeout": 0.1}
DRIVING: dict[str, Any] = {
    **PATIENT,
    "drive": True,
    "watchdog": 0.3,
    "feedback_timeout": 2.0,
    "angular_velocity": 8.0,
    "linear_velocity": 2.0,
}
"""So that a busy machine ends nothing."""


def efforts() -> Iterator[list[float]]:
    """A small one of the first joint, to and fro."""
    for sign in itertools.cycle((1.0, -1.0)):
        yield [0.02 * sign, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def bare(sim: RunningSim, seconds: float, *, drives: bool) -> Figures:
    """Exchange the same bytes by a socket alone, currents before them if it drives."""
    asked = [
        packets.datagram(packets.read_block(node, 0, QUADLETS, 7), GENERATION, forward=True)
        for node in NODES
    ]
    none = {axis: Motor(0x8000) for axis in range(AXES)}
    told = [
        packets.datagram(
            packets.write_block(node, 0, order(board, none), 0), GENERATION, forward=True
        )
        for node, board in zip(NODES, BOARDS, strict=True)
    ]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as boards:
        boards.connect((sim.host, sim.ports["boards"]))

        def once() -> None:
            for each in told if drives else ():
                boards.send(each)
            for each in asked:
                boards.send(each)
                boards.recv(2048)

        return looped(once, seconds)


def alone(sim: RunningSim, seconds: float) -> Figures:
    """Read by the device, without an engine."""
    device = DvrkDevice(PLUGIN.sim_config(DvrkConfig(**PATIENT), sim))
    device.open(time.monotonic() + 10.0)
    try:
        return looped(lambda: device.read(time.monotonic() + 1.0), seconds)
    finally:
        device.close()


def driving_alone(sim: RunningSim, seconds: float) -> Figures:
    """Drive by the device, without an engine."""
    device = DrivenDevice(PLUGIN.sim_config(DvrkConfig(**DRIVING), sim))
    device.open(time.monotonic() + 10.0)
    try:
        for _ in itertools.chain(device.services["set_encoders"].run(), device.enable()):
            device.read(time.monotonic() + 1.0)
        given = map(vector, efforts())

        def once() -> None:
            device.write(Setpoint(Mode.JOINT_EFFORT, next(given)))
            device.read(time.monotonic() + 1.0)

        found = looped(once, seconds)
        if device.condition.reason:
            raise RuntimeError(device.condition.reason)
        return found
    finally:
        device.close()


@contextmanager
def connected(sim: RunningSim, **values: Any) -> Iterator[LocalDevice]:
    """The driver as it is."""
    session = Session(PLUGIN, PLUGIN.sim_config(DvrkConfig(**values), sim))
    arm = LocalDevice(session)
    try:
        session.start()
        while not (arm.engine.connected and arm.engine.has_sample):
            time.sleep(0.01)
        yield arm
    finally:
        arm.close()


def sampled(arm: LocalDevice, seconds: float) -> Figures:
    """Let a driver read for a while."""
    stamps: list[float] = []

    def note() -> None:
        found = arm.engine.feedback("measured_js")
        if found is not None:
            stamps.append(found[1].monotonic)

    arm.engine.on_sample = note
    began, used = time.perf_counter(), time.process_time()
    time.sleep(seconds)
    passed, cpu = time.perf_counter() - began, time.process_time() - used
    arm.engine.on_sample = None
    return Figures(np.diff(stamps).tolist(), cpu / max(1, len(stamps)), passed)


def driver(sim: RunningSim, rate: float, seconds: float) -> Figures:
    """Read by the driver as it is, at a rate."""
    with connected(sim, rate=rate, **PATIENT) as arm:
        return sampled(arm, seconds)


def driving(sim: RunningSim, rate: float, seconds: float) -> Figures:
    """Drive by the driver as it is, at a rate, with as many efforts."""
    with connected(sim, rate=rate, sample_timeout=1.9, **DRIVING) as arm:
        arm.set_encoders()
        arm.enable()
        over = threading.Event()

        def stream() -> None:
            given = efforts()
            while not over.wait(1.0 / rate):
                with contextlib.suppress(CommandRefused):  # where the machine was held up
                    arm.servo_jf(next(given))

        thread = threading.Thread(target=stream)
        thread.start()
        try:
            found = sampled(arm, seconds)
        finally:
            over.set()
            thread.join()
        if not arm.is_enabled():
            raise RuntimeError(arm.operating_state().detail)
        return found


def row(name: str, figures: Figures) -> list[str]:
    """Return the row of a loop."""
    rate = len(figures.times) / figures.seconds
    return [name, f"{rate:.0f}", *spread(figures.times, 1e3, 2), f"{1e6 * figures.cpu:.0f}"]


def main() -> None:
    """Print the table."""
    given = options(__doc__, seconds=(10.0, "of each loop"))
    with SIM.spawn(patience=20.0) as sim:
        rows = [  # what is compared is measured one after the other: the machine's load changes
            row("bare socket loop, as fast as it goes", bare(sim, given.seconds, drives=False)),
            row("bare socket loop, driving", bare(sim, given.seconds, drives=True)),
            row("device alone, as fast as it goes", alone(sim, given.seconds)),
            row("device alone, driving", driving_alone(sim, given.seconds)),
        ]
        for rate in RATES:
            rows.append(row(f"driver at {rate:.0f} Hz", driver(sim, rate, given.seconds)))
            rows.append(row(f"driver at {rate:.0f} Hz, driving", driving(sim, rate, given.seconds)))
    columns = ["", "readings/s", "p50 ms", "p99 ms", "max ms", "CPU us"]
    show("A PSM on two boards, over UDP on this machine", columns, rows, [NOTE])


if __name__ == "__main__":
    main()
