"""Defects of simulated servos are what the driver measures; joints beside them are sound."""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest

from crtk_drivers.samples import JointState, Stamp
from rigs.dynamixel_bench import (
    COUNT,
    LONG,
    PATIENT,
    DynamixelBench,
    dynamixel_bench,
    eventually,
)

DEFECTS = (
    "position_noise=0.02,joints=1",
    "effort_sign=-1,joints=2",
    "backlash=0.04,joints=3",
    "velocity_scale=1.5,joints=4",
    "following_offset=0.03,joints=5",
    "jump_on_enable=0.1,joints=6",
)
NOISY, WRONG_WAY, LOOSE, FAST, ASIDE, JUMPY = range(6)
"""The joints, in the order of their servos; in this arm their angles are those of the horns."""


class Enabled(NamedTuple):
    bench: DynamixelBench
    jumped: np.ndarray


@pytest.fixture(scope="module")
def enabled() -> Iterator[Enabled]:
    """Servos with defects behind a driver, and by how much they moved when they were enabled."""
    with dynamixel_bench(defects=";".join(DEFECTS), timing="none") as bench:
        before = bench.angles()[:6]
        bench.enable()
        bench.cycles(20)
        bench.until_still()
        yield Enabled(bench, bench.angles()[:6] - before)


@pytest.fixture
def bench(enabled: Enabled) -> DynamixelBench:
    return enabled.bench


def sample(bench: DynamixelBench) -> tuple[JointState, Stamp]:
    """Return the next joint state that is measured, and its stamp."""
    bench.cycles(1)
    found = bench.engine.feedback("measured_js")
    assert found is not None
    assert isinstance(found[0], JointState)
    return found[0], found[1]


def samples(bench: DynamixelBench, count: int = 40) -> list[JointState]:
    return [sample(bench)[0] for _ in range(count)]


def go(bench: DynamixelBench, joint: int, position: float) -> None:
    """Move a joint, wait until it stands, and see that it did."""
    goal = np.array(bench.arm.setpoint_js().position)
    goal[joint] = position
    assert bench.arm.move_jp(goal).wait(LONG)
    bench.until_still()


def test_torque_that_goes_on_moves_the_joint_and_no_other(enabled: Enabled) -> None:
    assert enabled.jumped[JUMPY] == pytest.approx(0.1, abs=0.01)
    sound = np.delete(enabled.jumped, [NOISY, ASIDE, JUMPY])
    assert np.abs(sound).max() < 0.01


def test_a_position_is_noisy(bench: DynamixelBench) -> None:
    spread = np.std([state.position for state in samples(bench)], axis=0)
    assert spread[NOISY] == pytest.approx(0.02, rel=0.5)
    assert spread[FAST] < 3 * COUNT


def test_an_effort_has_the_wrong_sign(bench: DynamixelBench) -> None:
    for joint in (WRONG_WAY, LOOSE):
        go(bench, joint, 0.4)
    efforts = np.mean([state.effort for state in samples(bench)], axis=0)
    torques = [servo["torque_applied"] for servo in bench.servos().values()]
    assert efforts[WRONG_WAY] == pytest.approx(-torques[WRONG_WAY], rel=0.3)
    assert efforts[LOOSE] == pytest.approx(torques[LOOSE], rel=0.3)


@pytest.mark.slow  # test_joint_defects.py has it without a driver
def test_what_is_measured_stays_behind_the_motor(bench: DynamixelBench) -> None:
    behind = {}
    for joint in (LOOSE, FAST):
        for came_from in (-0.2, 0.6):
            go(bench, joint, came_from)
            go(bench, joint, 0.2)
            measured = np.mean([state.position for state in samples(bench)], axis=0)
            behind[joint, came_from] = (measured - bench.angles()[:6])[joint]
    assert behind[LOOSE, -0.2] == pytest.approx(-0.02, abs=3 * COUNT)
    assert behind[LOOSE, 0.6] == pytest.approx(0.02, abs=3 * COUNT)
    assert behind[FAST, -0.2] == pytest.approx(behind[FAST, 0.6], abs=3 * COUNT)


@pytest.mark.parametrize(("joint", "factor"), [(FAST, 1.5), (ASIDE, 1.0)])
def test_a_velocity_is_too_great(bench: DynamixelBench, joint: int, factor: float) -> None:
    go(bench, joint, 0.0)
    goal = np.array(bench.arm.setpoint_js().position)
    goal[joint] = 1.0
    found = [sample(bench)]

    def keep() -> None:
        state = bench.engine.feedback("measured_js")
        assert state is not None
        assert isinstance(state[0], JointState)
        found.append((state[0], state[1]))

    bench.engine.on_sample = keep  # in its thread: a test that is held up misses none
    try:
        assert bench.arm.move_jp(goal).wait(LONG)
        eventually(lambda: abs(found[-1][0].velocity[joint]) <= 0.1, "it stands")
    finally:
        bench.engine.on_sample = None
    told, gone = 0.0, 0.0
    for (before, since), (after, now) in pairwise(found):
        if (
            now.monotonic - since.monotonic < 2.5 / PATIENT["rate"]
        ):  # else nobody knows what it did meanwhile
            mean = (before.velocity[joint] + after.velocity[joint]) / 2.0
            told += mean * (now.monotonic - since.monotonic)
            gone += after.position[joint] - before.position[joint]
    assert told / gone == pytest.approx(factor, rel=0.1)


def test_a_joint_rests_beside_its_setpoint(bench: DynamixelBench) -> None:
    for joint in (ASIDE, FAST):
        go(bench, joint, 0.2)
    off = np.mean([state.position for state in samples(bench)], axis=0) - 0.2
    assert off[ASIDE] == pytest.approx(0.03, abs=0.01)
    assert abs(off[FAST]) < 0.01
