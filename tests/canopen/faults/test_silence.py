"""Drives that are not heard for a while: heard again, no joint jumps to where it should be by now."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest
from typing_extensions import override

from crtk_driver_canopen.device import LOST_TIME
from crtk_drivers.engine import Observer
from crtk_drivers.errors import CommandRefused
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import Stamp
from crtk_drivers.state import Status
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import JOINT, PERIOD, arm_of, arm_on, device_of, drives, wait_for_sync
from rigs.waiting import LONG, eventually

COUNT = 2
SPEED = 0.5
"""Of the stream, rad/s: in the time until FAULT it goes 0.25 rad."""
WAITS = 2.0
"""Seconds that drives wait for us: longer than they are silent."""
PATIENT: dict[str, Any] = {
    "missed_cycles": 100,
    "heartbeat": {"ours_timeout": WAITS, "drives_timeout": WAITS},
}
SILENT = 0.6
"""Seconds: whoever is held up meanwhile misses them, and does not give them up."""
STEPS = 0.02
"""rad that a joint may still go to the last targets that it was sent, and by its own overshoot."""


class WhenFault(Observer):
    """Ends a fault of the simulator as FAULT is announced, in the I/O thread: nothing more was sent."""

    def __init__(self, sim: RunningSim, kind: str) -> None:
        self.sim, self.kind = sim, kind
        self.before: np.ndarray | None = None
        self.done = threading.Event()

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        if status.state == "FAULT" and not self.done.is_set():
            self.before = joints(self.sim)
            self.sim.control.clear(self.kind)
            self.done.set()


@contextmanager
def patient_drives() -> Iterator[RunningSim]:
    """Drives that wait for SYNC, too."""
    with drives(COUNT) as sim:
        for node in range(1, COUNT + 1):
            wait_for_sync(sim, node, WAITS)
        yield sim


def told(sim: RunningSim, name: str) -> np.ndarray:
    found = sim.control.status()["drives"]
    return np.array([found[str(node)]["axes"][0][name] for node in range(1, COUNT + 1)])


def joints(sim: RunningSim) -> np.ndarray:
    """Where the joints really are, rad."""
    return told(sim, "revolutions") * 2.0 * np.pi / JOINT["gear"]


@contextmanager
def streaming(sim: RunningSim, command: str, arm: LocalDevice) -> Iterator[None]:
    """Have both joints move at `SPEED`."""
    ended, position = threading.Event(), [0.0]

    def stream() -> None:
        while not ended.wait(PERIOD):
            position[0] += SPEED * PERIOD
            with suppress(CommandRefused):
                getattr(arm, command)(position * COUNT)

    def move() -> bool:
        here = float(joints(sim).min())
        if position[0] > here + 0.15:
            position[0] = here  # a busy machine has stalled the stream: it begins again
        return here > 0.2

    if command == "move_jp":
        arm.trajectory_j.set_ratio_v(SPEED / JOINT["velocity"])
        arm.move_jp([2.5] * COUNT)
    thread = threading.Thread(target=stream if command != "move_jp" else ended.wait)
    thread.start()
    try:
        eventually(move, "both joints move")
        yield
    finally:
        ended.set()
        thread.join()


@pytest.mark.sweep(6)
@pytest.mark.parametrize("command", ["servo_jp", "interpolate_jp", "move_jp"])
@pytest.mark.parametrize("which", [{}, {"node": 1}], ids=["all drives", "one drive"])
def test_drives_that_are_heard_again_after_fault_stay_where_they_are(
    command: str, which: dict[str, Any]
) -> None:
    config = {**PATIENT, "missed_cycles": 50}
    with patient_drives() as sim, arm_of(arm_on(sim, COUNT, **config)) as arm:
        arm.enable(LONG)
        again = WhenFault(sim, "silent")
        with streaming(sim, command, arm):
            arm.engine.add_observer(again)
            sim.control.inject("silent", **which)
            eventually(again.done.is_set, "it is in FAULT")
            assert again.before is not None
            silent = slice(0, 1) if which else slice(None)
            far = 0.0
            end = time.monotonic() + WAITS + 0.2
            while time.monotonic() < end:
                far = max(far, np.abs(joints(sim) - again.before)[silent].max())
            assert far < STEPS


@pytest.mark.sweep(2)
@pytest.mark.parametrize("command", ["servo_jp", "interpolate_jp"])
def test_a_drive_that_is_heard_again_before_fault_catches_up_within_its_limits(
    command: str,
) -> None:
    limits: dict[str, Any] = {"velocity": 1.0, "drive_limits": "keep"}
    with patient_drives() as sim, arm_of(arm_on(sim, COUNT, limits, **PATIENT)) as arm:
        arm.enable(LONG)
        link = device_of(arm).link
        with streaming(sim, command, arm):
            sim.control.inject("silent", node=1, duration=SILENT)
            eventually(lambda: link.cycle.ages[0] * PERIOD > LOST_TIME, "it is silent")
            looks: list[tuple[float, float, float]] = []  # before, where, after
            while not looks or looks[-1][0] < looks[0][0] + SILENT + 1.0:
                before = time.monotonic()
                looks.append((before, joints(sim)[0], time.monotonic()))
            # Over so long that a busy machine does not count.
            later = [next((n for n in looks if n[0] > look[0] + 0.1), None) for look in looks]
            pairs = [(a, b) for a, b in zip(looks, later, strict=True) if b is not None]
            fastest = max((end[1] - begin[1]) / (end[2] - begin[0]) for begin, end in pairs)
            assert fastest < 1.5 * limits["velocity"]
            assert arm.operating_state().state == "ENABLED", arm.operating_state().detail
            eventually(lambda: np.ptp(joints(sim)) < 0.05, "it has caught up")


def test_drives_that_are_all_silent_are_lost_no_sooner_than_is_configured() -> None:
    with patient_drives() as sim, arm_of(arm_on(sim, COUNT, **PATIENT)) as arm:
        arm.enable(LONG)
        link = device_of(arm).link
        sim.control.inject("silent", duration=SILENT)
        eventually(lambda: link.age * PERIOD > LOST_TIME, "they are silent")
        eventually(lambda: not link.age, "they are heard again")
        assert arm.operating_state().state == "ENABLED", arm.operating_state().detail
        assert not arm.health().reconnects
