"""Velocities and accelerations of moves that the drives plan."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from crtk_driver_canopen.profiles import ProfileRates, shared_rates

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
