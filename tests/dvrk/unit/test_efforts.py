"""Efforts of joints as currents of motors: virtual work, and limits that hold for every combination."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_driver_dvrk.arm_file import read_arm
from crtk_driver_dvrk.efforts import Efforts
from crtk_driver_dvrk.motor_file import read_motors
from crtk_driver_dvrk.plugin import TYPICAL
from crtk_drivers.samples import vector
from rigs.dvrk_bench import ZERO

MOTORS = read_motors(TYPICAL["io"])
COUPLING = read_arm(TYPICAL["io"], coupling=TYPICAL["coupling"]).coupling
SHARE = 0.5
MOST = SHARE * np.array([motor.most for motor in MOTORS])
SHARES = st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7)


@pytest.fixture(scope="module")
def efforts() -> Efforts:
    return Efforts(MOTORS, COUPLING, SHARE)


def test_no_effort_is_no_current(efforts: Efforts) -> None:
    assert list(efforts.bits(vector([0.0] * 7))) == ZERO
    assert list(efforts.zero) == ZERO


def test_an_effort_becomes_the_current_of_the_file(efforts: Efforts) -> None:
    """0.5 N·m on the first joint: 0.404 A/(N·m), and -5242.88 bits/A."""
    found = efforts.bits(vector([0.5] + [0.0] * 6))
    assert found[0] == round(32768 - 5242.88 * 0.5 * 0.4040893846)
    assert list(found[1:]) == ZERO[1:]


@settings(max_examples=60)
@given(SHARES)
def test_joints_and_motors_do_the_same_work(shares: list[float]) -> None:
    efforts = Efforts(MOTORS, COUPLING, SHARE)
    told = np.array(shares) * efforts.most
    scales = np.array([motor.effort_to_current for motor in MOTORS])
    of_motors = efforts.amperes(vector(told)) / scales
    moved = np.linspace(-1.0, 1.0, 7)
    assert of_motors @ moved == pytest.approx(told @ (COUPLING @ moved))


@settings(max_examples=60)
@given(SHARES)
def test_no_combination_within_the_limits_asks_a_motor_for_more(shares: list[float]) -> None:
    efforts = Efforts(MOTORS, COUPLING, SHARE)
    told = vector(np.array(shares) * efforts.most)
    assert (abs(efforts.amperes(told)) <= MOST * (1.0 + 1e-9)).all()
    rows = zip(MOTORS, efforts.bits(told), MOST, strict=True)
    for motor, bits, most in rows:
        assert abs(bits - motor.to_bits.offset) <= abs(motor.to_bits.scale) * most + 1.0


def test_a_joint_with_a_motor_of_its_own_may_have_all_of_its_share(efforts: Efforts) -> None:
    assert efforts.most[0] == pytest.approx(MOST[0] / 0.4040893846)


@pytest.mark.parametrize("value", [1e3, np.nan, np.inf, -np.inf])
def test_what_is_more_or_no_number_never_becomes_a_current(efforts: Efforts, value: float) -> None:
    with pytest.raises(ValueError, match="more than may be"):
        efforts.bits(vector([0.0] * 6 + [value]))
