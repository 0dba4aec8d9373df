"""The vendor's axes, units and matrices in ours."""

from __future__ import annotations

import math

import pytest

from crtk_driver_openhaptics.process import ours, pose, theirs
from crtk_drivers.kit.haptics.triples import turn

RIGHT, UP, TO_USER = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
STRAIGHT = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]


def test_axes_are_ahead_left_up() -> None:
    assert ours(TO_USER) == (-1.0, 0.0, 0.0)
    assert ours(RIGHT) == (0.0, -1.0, 0.0)
    assert ours(UP) == (0.0, 0.0, 1.0)
    for vector in (RIGHT, UP, TO_USER, (1.0, 2.0, 3.0)):
        assert theirs(ours(vector)) == vector


def test_a_transform_is_in_columns_and_mm() -> None:
    position, orientation = pose([*STRAIGHT, 10.0, 20.0, -30.0, 1.0])
    assert position == pytest.approx((0.03, -0.01, 0.02))
    assert orientation == pytest.approx((0.0, 0.0, 0.0, 1.0))


@pytest.mark.parametrize(("axis", "turned"), [(0, (0, -1, 0)), (1, (0, 0, 1)), (2, (-1, 0, 0))])
def test_a_turn_is_about_the_same_axis(axis: int, turned: tuple[int, int, int]) -> None:
    c, s = math.cos(0.4), math.sin(0.4)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    rows = [[float(i == j) for j in range(3)] for i in range(3)]
    rows[a][a] = rows[b][b] = c
    rows[a][b], rows[b][a] = -s, s
    columns = [x for j in range(3) for x in (rows[0][j], rows[1][j], rows[2][j], 0.0)]
    _, orientation = pose([*columns, 0.0, 0.0, 0.0, 1.0])
    found = turn(orientation, (0.0, 0.0, 0.0, 1.0))
    assert found == pytest.approx([0.4 * each for each in turned], abs=1e-9)
