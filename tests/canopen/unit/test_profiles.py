"""Velocities and accelerations of moves that the drives plan."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from crtk_driver_canopen.profiles import ProfileRates, arrival, shared_rates, velocities_from_motion

rates = st.floats(0.01, 100.0)


@given(st.lists(st.tuples(st.floats(-10.0, 10.0), rates, rates), min_size=1, max_size=8))
def test_all_joints_arrive_together_within_their_limits(
    joints: list[tuple[float, float, float]],
) -> None:
    distances, velocities, accelerations = map(np.array, zip(*joints, strict=True))
    assume(np.abs(distances).max() > 1e-6)
    velocity, acceleration = shared_rates(distances, velocities, accelerations)
    assert (velocity <= velocities * (1 + 1e-9)).all()
    assert (acceleration <= accelerations * (1 + 1e-9)).all()
    moving = np.abs(distances) > 1e-6 * np.abs(distances).max()
    for each, limit in ((velocity, velocities), (acceleration, accelerations)):
        # Each has its share of the way, and at least one joint has all it may.
        shares = each[moving] / np.abs(distances[moving])
        np.testing.assert_allclose(shares, shares[0], rtol=1e-6)
        assert (each[moving] / limit[moving]).max() == pytest.approx(1.0)


def test_joints_that_are_there_keep_their_limits() -> None:
    velocity, acceleration = shared_rates(np.zeros(2), np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    assert (velocity.tolist(), acceleration.tolist()) == ([1.0, 2.0], [3.0, 4.0])


@pytest.mark.parametrize(
    ("velocity", "acceleration", "unit", "counts"),
    [
        (2.0, 10.0, 0.001, (2000, 10_000)),
        (2.0, 10.0, -0.001, (2000, 10_000)),
        (1e-9, 0.0, 0.001, (1, 1)),
        (1e9, 1e9, 1e-9, (0xFFFFFFFF, 0xFFFFFFFF)),
    ],
)
def test_rates_in_the_units_of_a_drive(
    velocity: float, acceleration: float, unit: float, counts: tuple[int, int]
) -> None:
    assert ProfileRates.of(velocity, acceleration, unit) == counts


motions = st.tuples(st.floats(-10.0, 10.0), st.floats(-5.0, 5.0), st.floats(0.1, 5.0), rates)


@given(motions)
def test_the_time_of_arrival_is_that_of_the_profile_step_by_step(
    motion: tuple[float, float, float, float],
) -> None:
    distance, speed, velocity, acceleration = motion
    expected = arrival(*motion)
    assume(0.05 < expected < 20.0)
    dt = expected / 2000.0
    fastest = min(velocity, abs(speed) + math.sqrt(acceleration * abs(distance)))
    position, now, seconds = 0.0, speed, 0.0
    while abs(distance - position) > 2.0 * dt * (fastest + abs(now)) or abs(now) > 4.0 * (
        acceleration * dt
    ):
        left = distance - position
        toward = math.copysign(1.0, left)
        wanted = toward * min(velocity, math.sqrt(2.0 * acceleration * abs(left)))
        change = acceleration * dt
        now += min(max(wanted - now, -change), change)
        position += now * dt
        seconds += dt
        assert seconds < 1.5 * expected + 0.1, (motion, expected)
    assert seconds == pytest.approx(expected, rel=0.1, abs=20.0 * dt)


@given(st.lists(motions, min_size=1, max_size=8))
def test_joints_in_motion_arrive_with_the_slowest_and_none_is_faster_than_it_may(
    joints: list[tuple[float, float, float, float]],
) -> None:
    distances, speeds, limits, accelerations = map(np.array, zip(*joints, strict=True))
    velocities = velocities_from_motion(distances, speeds, limits, accelerations)
    assert (velocities <= limits).all()
    longest = max(arrival(*joint) for joint in joints)
    for (distance, speed, limit, acceleration), velocity in zip(joints, velocities, strict=True):
        takes = arrival(distance, speed, velocity, acceleration)
        assert takes <= longest * (1 + 1e-9)
        slowest = arrival(distance, speed, 0.011 * limit, acceleration)
        if slowest > longest:  # it can be made that slow
            assert takes == pytest.approx(longest, rel=1e-3, abs=1e-3)
