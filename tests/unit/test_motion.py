"""Profiles and moves."""

import math
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_drivers.device import JointLimits
from crtk_drivers.errors import MotionAborted
from crtk_drivers.motion import JointProfile
from crtk_drivers.moves import Move, Outcome
from crtk_drivers.samples import EMPTY, vector

LIMIT = JointLimits(-2.0, 2.0, velocity=1.0, acceleration=5.0, jerk=50.0, effort=1.0)
place = st.tuples(*[st.floats(-2.0, 2.0)] * 2).map(vector)
REST = vector((0.0, 0.0))


@settings(max_examples=50)
@given(place, place, st.floats(0.05, 1.0))
def test_a_profile_starts_where_it_should_ends_at_its_goal_at_rest_and_keeps_its_limits(
    start: np.ndarray, goal: np.ndarray, ratio: float
) -> None:
    profile = JointProfile(start, REST, goal, (LIMIT, LIMIT), ratio)
    assert profile.at(0.0)[0] == pytest.approx(start, abs=1e-9)
    for time in (profile.duration, profile.duration + 10.0):
        position, velocity = profile.at(time)
        assert position.tolist() == goal.tolist(), "exactly: it may lie on a limit"
        assert velocity.tolist() == [0.0, 0.0]
    for time in np.linspace(0.0, profile.duration, 50):
        _, velocity = profile.at(float(time))
        assert np.abs(velocity).max() <= LIMIT.velocity * ratio + 1e-6


def test_a_profile_blends_from_a_velocity() -> None:
    profile = JointProfile(REST, vector((0.5, 0.0)), vector((1.0, 0.0)), (LIMIT, LIMIT))
    assert profile.at(0.0)[1] == pytest.approx([0.5, 0.0])


@pytest.mark.parametrize("goal", [math.nan, math.inf])
def test_an_impossible_goal_aborts(goal: float) -> None:
    with pytest.raises(MotionAborted, match="no trajectory"):
        JointProfile(REST, REST, vector((goal, 0.0)), (LIMIT, LIMIT))


def test_no_joints_abort_instead_of_ending_the_process() -> None:
    with pytest.raises(MotionAborted, match="0 joints"):
        JointProfile(EMPTY, EMPTY, EMPTY, ())
    with pytest.raises(MotionAborted, match="from 0 to 2"):
        JointProfile(EMPTY, REST, REST, (LIMIT, LIMIT))


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
        move.wait(5.0)
