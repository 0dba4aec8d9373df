"""Finger kinematics: known figures, and the inverse checked against the forward."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel.gripper import Finger, Jaw, Linear, SliderCrank
from crtk_drivers.errors import ConfigError

lengths = st.floats(0.005, 0.2)
angles = st.floats(-1.5, 1.5)


@st.composite
def cranks(draw: st.DrawFn) -> SliderCrank:
    horn = draw(lengths)
    return SliderCrank(horn, horn * draw(st.floats(1.05, 5.0)), draw(st.floats(-0.05, 0.05)))


fingers = st.one_of(
    cranks(),
    st.builds(Linear, st.floats(0.001, 0.1) | st.floats(-0.1, -0.001), st.floats(-0.1, 0.1)),
    st.just(Jaw()),
)


@pytest.mark.parametrize(
    ("angle", "opening"),
    [
        (0.0, 2.0 * math.sqrt(0.036**2 - 0.022**2)),
        (math.pi / 2, 2.0 * (0.036 + 0.022)),
        (-math.pi / 2, 2.0 * (0.036 - 0.022)),
    ],
)
def test_slider_crank_at_known_angles(angle: float, opening: float) -> None:
    crank = SliderCrank(0.022, 0.036)
    assert crank.opening(angle) == pytest.approx(opening)
    assert crank.angle(opening) == pytest.approx(angle, abs=1e-6)


@given(cranks(), angles)
def test_the_rod_keeps_its_length(crank: SliderCrank, angle: float) -> None:
    """The pin of the horn and the finger's carrier are as far apart as the rod is long."""
    finger = 0.5 * (crank.opening(angle) + crank.gap)
    pin = (crank.horn * math.sin(angle), crank.horn * math.cos(angle))
    assert math.hypot(finger - pin[0], pin[1]) == pytest.approx(crank.rod)


@given(fingers, angles)
def test_there_and_back(finger: Finger, angle: float) -> None:
    assert finger.angle(finger.opening(angle)) == pytest.approx(angle, abs=1e-6)


@given(fingers, st.floats(-1.4, 1.4))
def test_rate_is_the_derivative(finger: Finger, angle: float) -> None:
    step = 1e-5
    slope = (finger.opening(angle + step) - finger.opening(angle - step)) / (2.0 * step)
    assert finger.rate(angle) == pytest.approx(slope, rel=1e-4, abs=1e-7)


@given(fingers, st.floats(-1.4, 1.4), st.floats(-5.0, 5.0))
def test_efforts_do_the_work_of_the_torque(finger: Finger, angle: float, torque: float) -> None:
    effort = finger.effort(torque, angle)
    assert effort * finger.rate(angle) == pytest.approx(torque, abs=1e-12)
    assert finger.torque(effort, angle) == pytest.approx(torque, abs=1e-12)


def test_state_is_all_three() -> None:
    crank = SliderCrank(0.022, 0.036)
    opening, velocity, effort = crank.state(0.2, 3.0, 0.5)
    assert opening == crank.opening(0.2)
    assert velocity == pytest.approx(3.0 * crank.rate(0.2))
    assert effort == pytest.approx(crank.effort(0.5, 0.2))
    assert math.isnan(crank.state(0.2, 3.0, math.nan)[2])


def test_a_dead_point_has_no_lever() -> None:
    crank = SliderCrank(1.0, 2.0)
    angle = math.pi / 2
    assert abs(crank.effort(1.0, angle)) > 1e12
    assert crank.effort(0.0, angle) == 0.0


@pytest.mark.parametrize("opening", [-0.05, 0.0, 0.02799, 0.11601, 1.0])
def test_what_cannot_be_reached_is_refused(opening: float) -> None:
    with pytest.raises(ConfigError, match=r"cannot be reached.*from 0\.028 to 0\.116 m"):
        SliderCrank(0.022, 0.036).angle(opening)


@pytest.mark.parametrize(
    ("horn", "rod"), [(0.0, 1.0), (-0.1, 1.0), (1.0, 1.0), (1.0, math.inf), (math.nan, 1.0)]
)
def test_impossible_cranks(horn: float, rod: float) -> None:
    with pytest.raises(ConfigError, match="cannot push a finger"):
        SliderCrank(horn, rod)


@pytest.mark.parametrize("travel", [0.0, math.nan, math.inf])
def test_impossible_travel(travel: float) -> None:
    with pytest.raises(ConfigError, match="a travel of"):
        Linear(travel)
