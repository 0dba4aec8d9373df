"""A gateway that holds frames back, all by the same time: what drives told is stamped as old as it is."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from crtk_drivers.front import LocalDevice
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import PERIOD, arm_of, device_of, drives, patient_arm_on
from rigs.waiting import LONG, eventually

ROUNDS = 8
APART = 5
"""Counts from one position that is claimed to the next."""


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with drives(1) as running:
        yield running


@pytest.fixture(autouse=True)
def clear(sim: RunningSim) -> Iterator[None]:
    yield
    sim.control.clear()


def told(arm: LocalDevice) -> tuple[float, float]:
    """Return the position of the newest sample, and its stamp in monotonic seconds."""
    found = arm.engine.feedback("measured_js")
    assert found is not None
    return found[0].position[0], found[1].monotonic


def younger(sim: RunningSim, arm: LocalDevice, counts: int) -> float:
    """Let the drive tell another position; return by how much the last old one is stamped younger, in s."""
    before = told(arm)[0]
    sim.control.inject("claim", index=0x6064, data=counts.to_bytes(4, "little", signed=True).hex())
    changed, newest = time.monotonic(), 0.0
    while time.monotonic() < changed + LONG:
        position, stamp = told(arm)
        if position != before:
            return newest - changed
        newest = stamp
        time.sleep(0.001)
    raise AssertionError("it never told the other position")


@pytest.mark.parametrize(
    ("seconds", "begins"),
    [(0.02, "before it connects"), (0.02, "in mid-stream"), (0.05, "in mid-stream")],
)
def test_answers_held_back_are_stamped_old(sim: RunningSim, begins: str, seconds: float) -> None:
    """By when the simulator changed what the drive tells; each frame takes as long."""
    if begins == "before it connects":
        sim.control.inject("delay", seconds=seconds)
    with arm_of(patient_arm_on(sim, 1)) as arm:
        if begins == "in mid-stream":
            sim.control.inject("delay", seconds=seconds)
        eventually(lambda: device_of(arm).link.cycle.answers.owing, "answers are owed")
        start = device_of(arm).link.positions[0]
        apart = [younger(sim, arm, start + APART * (1 + turn % 2)) for turn in range(ROUNDS)]
        assert np.median(apart) < PERIOD
        assert np.median(apart) > -2.0 * seconds - 3.0 * PERIOD


def test_lost_answers_make_no_sample_old(sim: RunningSim) -> None:
    with arm_of(patient_arm_on(sim, 1)) as arm:
        link = device_of(arm).link
        for _ in range(5):
            before = dict(link._probed)
            sim.control.inject("message", effect="lost", id=0x181)
            eventually(lambda before=before: link._probed != before, "an answer was owed")
            eventually(lambda: not link.cycle.answers.owing, "what was sent behind is answered")
            sim.control.clear("message")
        age = lambda: link.stamp.monotonic - link.sampled.monotonic  # noqa: E731
        eventually(lambda: age() < 0.5 * PERIOD, "a sample of the newest SYNC")
