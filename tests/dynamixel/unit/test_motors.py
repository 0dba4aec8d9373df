"""Torques made of voltages."""

import numpy as np
import pytest

from crtk_driver_dynamixel.models import model_named
from crtk_driver_dynamixel.motors import MADE_UP, Motors
from crtk_driver_dynamixel.units import Servo
from crtk_drivers.samples import vector

XL430 = model_named("xl430-w250")
"""1.4 N.m and 57 rev/min at 11.1 V (e-manual)."""


def duty(torque: float, velocity: float = 0.0, voltage: float = 11.1, gear: float = 1.0) -> float:
    motors = Motors.of([Servo(XL430, gear=gear)])
    return float(motors.duty(vector([torque]), vector([velocity]), vector([voltage]))[0])


def test_at_rest_a_torque_is_a_share_of_the_stall_torque() -> None:
    assert duty(1.4) == pytest.approx(1.0)
    assert duty(-0.7) == pytest.approx(-0.5)
    assert duty(0.0) == 0.0
    assert duty(1.4, gear=2.0) == pytest.approx(0.5)


def test_a_lower_voltage_needs_more_of_it_and_an_unknown_one_is_that_of_the_figures() -> None:
    assert duty(0.7, voltage=5.55) == pytest.approx(1.0)
    assert duty(0.7, voltage=np.nan) == pytest.approx(0.5)
    assert duty(0.7, voltage=0.0) == pytest.approx(0.5)


def test_what_a_turning_motor_induces_is_made_up_for_but_never_more() -> None:
    fastest = XL430.no_load_speed
    assert duty(0.0, fastest) == pytest.approx(MADE_UP)
    assert MADE_UP < 1.0
    assert duty(0.7, -0.5 * fastest) == pytest.approx(0.5 - 0.5 * MADE_UP)
    assert duty(0.0, fastest / 2.0, gear=2.0) == pytest.approx(MADE_UP)
