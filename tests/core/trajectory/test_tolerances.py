"""Tolerances by the rules of joint_trajectory_controller."""

from __future__ import annotations

import math

import pytest

from crtk_drivers.samples import JointState, vector
from crtk_drivers.trajectory.tolerances import UNLIMITED, limits_of, resolved
from rigs.joint_trajectories import tolerance

TABLE = [
    # asked, default, in force
    (0.0, 0.3, 0.3),  # 0, or absent: the default
    (0.0, UNLIMITED, UNLIMITED),  # which may be none
    (0.2, 0.3, 0.2),
    (0.5, 0.3, 0.5),  # wider than the default too
    (0.2, UNLIMITED, 0.2),
    (-1.0, 0.3, UNLIMITED),  # erased
    (-0.5, 0.3, 0.3),  # illegal: the default
    (-2.0, 0.3, 0.3),
]


@pytest.mark.parametrize(("asked", "default", "expected"), TABLE)
def test_zero_is_the_default_and_minus_one_erases_it(
    asked: float, default: float, expected: float
) -> None:
    assert resolved(asked, default) == expected


def test_a_joint_that_is_not_named_has_the_default() -> None:
    limits = limits_of(("a", "b"), (tolerance("b", 0.1, -1.0),), (0.3, 0.3), (0.01, 0.01))
    assert limits.position == (0.3, 0.1)
    assert limits.velocity == (0.01, math.inf)


VIOLATIONS = [
    ([0.05, 0.0], [0.0, 0.0], ""),
    ([0.15, 0.0], [0.0, 0.0], "the position of a is 0.1500, 0.1500 from 0.0000 (at most 0.1)"),
    ([0.0, 99.0], [0.0, 0.0], ""),
    ([0.0, 0.0], [0.0, -0.6], "the velocity of b is -0.6000, 0.6000 from 0.0000 (at most 0.5)"),
    ([0.05, 0.0], [], ""),  # what is not measured is not judged
    ([math.nan, 0.0], [0.0, 0.0], "the position of a is nan, nan from 0.0000 (at most 0.1)"),
]


@pytest.mark.parametrize(("position", "velocity", "expected"), VIOLATIONS)
def test_what_is_further_off_than_its_limit_is_told(
    position: list[float], velocity: list[float], expected: str
) -> None:
    asked = (tolerance("a", 0.1), tolerance("b", -1.0, 0.5))
    limits = limits_of(("a", "b"), asked, (0.3, 0.3), (UNLIMITED, UNLIMITED))
    desired = JointState(position=vector([0.0, 0.0]), velocity=vector([0.0, 0.0]))
    actual = JointState(position=vector(position), velocity=vector(velocity))
    assert limits.violated(desired, actual) == expected
