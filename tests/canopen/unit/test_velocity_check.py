"""Measured velocities against positions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_canopen.velocity_check import VelocityCheck

PERIOD = 0.004


def moved(factor: float, step: float = 1e-5, peak: float = 0.8, lag: float = 0.0) -> VelocityCheck:
    """A check after a move there and back, with velocities that are so many times the true ones."""
    check = VelocityCheck(1.0, step, PERIOD)
    for time in np.arange(0.0, 4.0, PERIOD).tolist():
        position = peak * (1.0 - math.cos(time))
        velocity = peak * math.sin(time - lag) * factor
        check.take(position, round(velocity / step) * step, time)
    return check


@given(st.floats(0.85, 1.15))
def test_a_small_difference_is_none(factor: float) -> None:
    assert moved(factor).judged
    assert moved(factor).agrees


@pytest.mark.parametrize("factor", [10.0, 0.1, 1.3, 0.7, -1.0, 0.0, 1000.0])
def test_another_unit_is_found(factor: float) -> None:
    check = moved(factor)
    assert check.judged
    assert not check.agrees
    assert check.ratio == pytest.approx(factor, abs=0.05 * abs(factor) + 0.01)
    assert "606Ch" in check.text()


def test_coarse_velocities_and_late_ones_are_no_other_unit() -> None:
    assert moved(1.0, step=0.105).agrees
    assert moved(1.0, lag=0.02).agrees


def test_a_joint_that_stands_is_not_judged() -> None:
    assert not moved(1.0, peak=0.0).judged
    assert not moved(1.0, peak=0.05).judged


def test_what_was_not_seen_counts_for_nothing() -> None:
    check = VelocityCheck(1.0, 1e-5, PERIOD)
    for n in range(1000):
        check.take(float(n), 0.5, n * PERIOD)
        check.forget()
    assert not check.judged
