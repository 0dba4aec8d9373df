"""The positions that an axis is really sent."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_canopen.targets import PositionTarget

VELOCITY, ACCELERATION = 200.0, 10.0
"""In counts a cycle, and a cycle²."""

paces = st.integers(-150, 150)


def test_what_is_wanted_is_sent_while_an_axis_is_heard() -> None:
    target = PositionTarget(VELOCITY, ACCELERATION)
    wanted = [0, 10, 5000, -3]
    assert [target.step(position, heard=True) for position in wanted] == wanted
    assert not target.behind


def test_an_axis_that_is_not_heard_is_sent_nothing_new() -> None:
    target = PositionTarget(VELOCITY, ACCELERATION)
    target.set(7)
    assert [target.step(position, heard=False) for position in (17, 27, 37)] == [7, 7, 7]
    assert target.behind


@given(
    pace=paces,
    silent=st.integers(1, 100),
    position=st.integers(-(2**31) + 100_000, 2**31 - 100_000),
)
def test_heard_again_it_catches_up_within_its_limits_and_without_going_past(
    pace: int, silent: int, position: int
) -> None:
    target = PositionTarget(VELOCITY, ACCELERATION)
    target.set(position)
    wanted = position
    for _ in range(silent):
        wanted += pace
        target.step(wanted, heard=False)
    sent = [position, position]
    for _ in range(1000):
        wanted += pace
        sent.append(target.step(wanted, heard=True))
        assert (wanted - sent[-1]) * pace >= -ACCELERATION * abs(pace)
        if not target.behind:
            break
    assert not target.behind
    assert sent[-1] == wanted
    speeds = np.diff(sent)
    assert np.abs(speeds).max() <= VELOCITY + 1
    assert np.abs(np.diff(speeds)).max() <= ACCELERATION + 2


@given(pace=paces)
def test_silent_again_while_it_catches_up_it_stays_where_it_is(pace: int) -> None:
    target = PositionTarget(VELOCITY, ACCELERATION)
    target.step(50 * pace, heard=False)
    for _ in range(3):
        sent = target.step(50 * pace, heard=True)
    assert target.step(60 * pace, heard=False) == sent


def test_whole_counts_that_are_coarser_than_a_step_of_acceleration_are_caught_up_with() -> None:
    target = PositionTarget(0.5, 0.001)
    target.step(3, heard=False)
    sent = [target.step(3, heard=True) for _ in range(20)]
    assert sent[-1] == 3
    assert not target.behind


def test_an_axis_that_follows_no_positions_is_sent_what_is_wanted() -> None:
    target = PositionTarget(VELOCITY, ACCELERATION)
    target.step(5000, heard=False)
    assert target.set(9) == 9
    assert not target.behind
