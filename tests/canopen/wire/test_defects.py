"""Defects of simulated drives are what the driver measures; drives beside them are sound."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import JointState, Stamp
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import JOINT, arm_of, drives, patient_arm_on
from rigs.waiting import LONG, eventually

GEAR = JOINT["gear"]
DEFECTS = (
    "position_noise=0.02,joints=1",
    "effort_sign=-1,joints=2",
    "backlash=4,joints=3",
    "velocity_scale=1.5,joints=4",
    "following_offset=2,joints=5",
    "sag_on_disable=3,joints=6",
)
NOISY, WRONG_WAY, LOOSE, FAST, ASIDE, SAGGING, SOUND = range(7)
"""The joints, in the order of their drives."""
STANDS = 10
"""Samples in a row that show no motion of a joint that stands."""


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with drives(7, defects=";".join(DEFECTS)) as running:
        yield running


@pytest.fixture(scope="module")
def shared(sim: RunningSim) -> Iterator[LocalDevice]:
    with arm_of(patient_arm_on(sim, 7)) as device:
        yield device


@pytest.fixture
def arm(shared: LocalDevice) -> LocalDevice:
    eventually(lambda: shared.engine.connected, "it is connected")
    shared.enable(timeout=LONG)
    return shared


def sample(arm: LocalDevice) -> tuple[JointState, Stamp]:
    """Return the next joint state that is measured, and its stamp."""
    before = arm.health().samples
    eventually(lambda: arm.health().samples > before, "a sample")
    found = arm.engine.feedback("measured_js")
    assert found is not None
    assert isinstance(found[0], JointState)
    return found[0], found[1]


def mean_of(arm: LocalDevice, name: str = "position") -> np.ndarray:
    found: np.ndarray = np.mean([getattr(sample(arm)[0], name) for _ in range(20)], axis=0)
    return found


def go(arm: Any, joints: list[int], positions: Any) -> list[tuple[JointState, Stamp]]:
    """Move joints, and return what was measured until they stood."""
    goal = np.array(arm.setpoint_js().position)
    goal[joints] = positions
    found: list[tuple[JointState, Stamp]] = []

    def keep() -> None:
        told = arm.engine.feedback("measured_js")
        assert told is not None
        assert isinstance(told[0], JointState)
        found.append((told[0], told[1]))

    arm.engine.on_sample = keep  # in its thread: a test that is held up misses none
    try:
        assert arm.move_jp(goal).wait(LONG)
        there = len(found) + STANDS

        def stands() -> bool:
            last = found[-STANDS:]
            return len(found) >= there and all(
                (abs(s.velocity[joints]) <= 0.01).all() for s, _ in last
            )

        eventually(stands, "it stands")
    finally:
        arm.engine.on_sample = None
    return found


def test_a_position_is_noisy(arm: LocalDevice) -> None:
    spread = np.std([sample(arm)[0].position for _ in range(60)], axis=0)
    assert spread[NOISY] == pytest.approx(0.02 / GEAR, rel=0.5)
    assert spread[SOUND] < 2e-5


def test_an_effort_has_the_wrong_sign(arm: LocalDevice) -> None:
    joints = [WRONG_WAY, SOUND]
    found = go(arm, joints, arm.setpoint_js().position[joints] + 0.5)
    for joint, sign in zip(joints, (-1.0, 1.0), strict=True):
        effort = np.array([state.effort[joint] for state, _ in found])
        velocity = np.array([state.velocity[joint] for state, _ in found])
        fast = np.abs(velocity) > 0.5 * np.abs(velocity).max()
        power = np.median(effort[fast] * velocity[fast])
        assert math.copysign(1.0, power) == sign  # friction takes work


@pytest.mark.slow  # test_joint_defects.py has it without a driver
def test_what_is_measured_stays_behind_the_motor(arm: LocalDevice) -> None:
    joints, rests = [LOOSE, SOUND], []
    for came_from in (-0.5, 0.5):
        go(arm, joints, came_from)
        go(arm, joints, 0.0)
        rests.append(mean_of(arm)[joints])
    assert rests[1] - rests[0] == pytest.approx((4.0 / GEAR, 0.0), abs=5e-3)


def test_a_velocity_is_too_great(arm: LocalDevice) -> None:
    joints = [FAST, SOUND]
    found = go(arm, joints, arm.setpoint_js().position[joints] + 1.0)
    for joint, factor in zip(joints, (1.5, 1.0), strict=True):
        positions = np.array([state.position[joint] for state, _ in found])
        velocities = np.array([state.velocity[joint] for state, _ in found])
        slopes = np.diff(positions) / np.diff([stamp.monotonic for _, stamp in found])
        told = 0.5 * (velocities[1:] + velocities[:-1])
        fast = slopes > 0.5 * np.median(slopes)
        # A sample that was held up spoils two slopes, and no median.
        assert np.median(told[fast] / slopes[fast]) == pytest.approx(factor, rel=0.1)


def test_a_joint_rests_beside_its_setpoint(arm: LocalDevice) -> None:
    go(arm, [ASIDE, SOUND], 0.2)
    off = mean_of(arm) - np.array(arm.setpoint_js().position)
    assert off[ASIDE] == pytest.approx(2.0 / GEAR, abs=3e-3)
    assert abs(off[SOUND]) < 3e-3


def test_a_joint_falls_when_power_goes(arm: LocalDevice) -> None:
    before = mean_of(arm)
    arm.disable(timeout=LONG)
    fallen = mean_of(arm) - before
    arm.enable(timeout=LONG)
    assert fallen[SAGGING] == pytest.approx(-3.0 / GEAR, abs=5e-3)
    assert abs(fallen[SOUND]) < 5e-3
