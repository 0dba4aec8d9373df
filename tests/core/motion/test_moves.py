"""Moves: their handle, and how one goes on where another was."""

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_drivers.device import Mode
from crtk_drivers.errors import MotionAborted
from crtk_drivers.motion.move import Move, Outcome
from rigs.examples import examples
from rigs.scripted_engine import LIMIT, PERIOD, Rig, jp, two_joints
from rigs.waiting import LONG


@settings(max_examples=examples(30), deadline=None)
@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.integers(1, 60))
def test_a_move_begins_with_the_velocity_and_acceleration_of_the_one_it_replaces(
    first: float, second: float, cycles: int
) -> None:
    rig = Rig(capabilities=two_joints(modes=frozenset({Mode.JOINT_POSITION}))).enabled()
    rig.engine.submit("move_jp", jp(first, 0.0))
    rig.cycle(cycles)
    before = len(rig.written)
    move = rig.engine.submit("move_jp", jp(second, 0.5))
    rig.cycle()
    assert len(rig.written) == before + 1, "no cycle is left out"
    rig.cycle(500)
    assert move is not None
    assert move.wait(0.0)
    path = np.array([[0.0, 0.0], *(setpoint.values for setpoint in rig.written)])
    assert path[-1].tolist() == [second, 0.5]
    velocity = np.diff(path, axis=0) / PERIOD
    acceleration = np.diff(velocity, axis=0) / PERIOD
    assert np.abs(velocity).max() <= LIMIT.velocity + 1e-6
    assert np.abs(acceleration).max() <= LIMIT.acceleration + 1e-4
    jerk = np.diff(acceleration, axis=0) / PERIOD
    assert np.abs(jerk).max() <= 2.0 * LIMIT.jerk, "the acceleration jumped"


def test_the_first_end_of_a_move_counts() -> None:
    move = Move("move_jp")
    assert not move.wait(0.0)
    assert move.wait(0.0, is_busy=True)
    move.finish(Outcome.REACHED)
    move.finish(Outcome.ABORTED, "too late")
    assert move.wait()
    assert move.outcome is Outcome.REACHED


def test_a_move_that_did_not_reach_its_goal_says_why() -> None:
    move = Move("move_cp")
    threading.Timer(0.01, move.finish, (Outcome.PREEMPTED, "by servo_jp")).start()
    with pytest.raises(MotionAborted, match="move_cp was pre-empted: by servo_jp"):
        move.wait(LONG)
