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


@pytest.mark.parametrize("step", [0.001, 0.3])
@pytest.mark.parametrize("count", [0.0001, 0.003, 0.006, 0.15])
@pytest.mark.parametrize("speed", [0.2, 0.59, 0.8])
def test_coarse_counts_are_no_other_unit(speed: float, count: float, step: float) -> None:
    """As of Hall sensors: 0.15 rad for a count, and velocities that are cut off to whole steps."""
    check = VelocityCheck(1.0, step, PERIOD, count)
    for n in range(1000):
        position = count * math.floor(n * PERIOD * speed / count)
        check.take(position, step * math.floor(speed / step + 1e-9), n * PERIOD)
    assert check.agrees, check.ratio


def test_ten_times_is_found_with_coarse_counts() -> None:
    check = VelocityCheck(1.0, 1e-3, PERIOD, 0.15)
    for n in range(2000):
        check.take(0.15 * math.floor(n * PERIOD * 0.8 / 0.15), 8.0, n * PERIOD)
    assert check.judged
    assert not check.agrees


def test_velocities_of_every_nth_cycle_are_no_other_unit() -> None:
    """`feedback_every`: at the begin of a move what is told is that it stands."""
    check, told = VelocityCheck(1.0, 1e-5, PERIOD, every=100), 0.0
    for n in range(3000):
        time = n * PERIOD
        speed = min(1.0, 5.0 * max(0.0, time - 0.01))
        position = 2.5 * time**2 if time < 0.2 else 0.1 + time - 0.2
        told = speed if n % 100 == 0 else told
        check.take(position, told, time)
    assert check.judged
    assert check.agrees, check.ratio


def test_a_joint_that_stands_is_not_judged() -> None:
    assert not moved(1.0, peak=0.0).judged
    assert not moved(1.0, peak=0.05).judged


def test_what_was_not_seen_counts_for_nothing() -> None:
    check = VelocityCheck(1.0, 1e-5, PERIOD)
    for n in range(1000):
        check.take(float(n), 0.5, n * PERIOD)
        check.forget()
    assert not check.judged
