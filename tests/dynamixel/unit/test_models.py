"""Every model against the e-manual: what a count is, what it can be told, and what it has."""

import math

import pytest

from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.control_tables import control_table, model_files
from crtk_driver_dynamixel.joints import Chain
from crtk_driver_dynamixel.models import MODELS, PROTOCOL_1_ERRORS, OperatingMode
from crtk_drivers.config import from_values, load

RPM = math.tau / 60.0

# e-manual, "Control Table Description": rad for a count, rev/min for a count of speed, by how names begin.
UNITS = {
    "x": (math.tau / 4096, 0.229),
    "2x": (math.tau / 4096, 0.229),
    "mx": (math.tau / 4096, 0.229),
    "mx-12w-1.0": (math.tau / 4096, 0.916),
    "mx-28-1.0": (math.tau / 4096, 0.114),
    "mx-64-1.0": (math.tau / 4096, 0.114),
    "mx-106-1.0": (math.tau / 4096, 0.114),
    "ax": (math.radians(300.0) / 1023, 0.111),
    "rx": (math.radians(300.0) / 1023, 0.111),
    "xl-320": (math.radians(300.0) / 1023, 0.111),
    "ph54": (math.tau / 1_003_846, 0.01),
    "ph42": (math.tau / 607_500, 0.01),
    "pm54": (math.tau / 502_834, 0.01),
    "pm42": (math.tau / 526_374, 0.01),
}

# e-manual, "Specifications": stall torque in N·m and rev/min without load at the recommended voltage.
RATINGS = {
    "2xc430-w250": (1.8, 64),
    "2xl430-w250": (1.4, 57),
    "ax-12a": (1.5, 59),
    "ax-12w": (0.2, 54),  # in joint mode, which this driver uses; 470 as a wheel
    "mx-12w-1.0": (0.2, 470),
    "xh430-w350": (3.4, 30),
    "xh540-v150": (6.4, 60),
    "xh540-v270": (9.2, 34),
    "xm540-w150": (7.3, 53),
    "xm540-w270": (10.6, 30),
    "xw540-t140": (6.9, 72),
    "xw540-t260": (9.5, 40),
}

WITHOUT_VELOCITY = ("ax-", "rx-", "xl-320", "-1.0")
"""As wheels they take a share of their output, or are set up for it by their limits."""


@pytest.mark.parametrize("name", MODELS)
def test_units(name):
    family = MODELS[name].family
    position, speed = UNITS[max((n for n in UNITS if name.startswith(n)), key=len)]
    assert family.position_unit == pytest.approx(position, rel=1e-9)
    assert family.velocity_unit == pytest.approx(speed * RPM, rel=1e-9)


@pytest.mark.parametrize("name", RATINGS)
def test_ratings(name):
    model, (torque, speed) = MODELS[name], RATINGS[name]
    assert model.stall_torque == torque
    assert model.no_load_speed == pytest.approx(speed * RPM)


@pytest.mark.parametrize("name", MODELS)
def test_what_the_control_table_has_is_what_is_said_of_the_model(name):
    model = MODELS[name]
    table = control_table(model.number)
    takes_velocities = OperatingMode.VELOCITY in model.modes
    assert model.family.has_watchdog == ("bus_watchdog" in table)
    assert takes_velocities == ("goal_velocity" in table)
    assert takes_velocities != any(part in name for part in WITHOUT_VELOCITY)
    assert (model.family.joint_mode is not None) == ("control_mode" in table)
    if OperatingMode.CURRENT in model.modes:
        assert "goal_current" in table
    assert "goal_position" in table


def test_every_model_of_the_sdk_is_known_or_left_out_on_purpose():
    numbers = {model.number for model in MODELS.values()}
    missing = {file for number, file in model_files().items() if number not in numbers}
    assert {file.split("_")[0] for file in missing} <= {
        "h42",
        "h54",
        "m42",
        "m54",
        "rh",
        "ym070",
        "ym080",
    }


def test_errors_of_the_xl_320_have_bits_of_their_own():
    assert MODELS["xl-320"].errors[0] == "overload"
    assert MODELS["xm430-w350"].errors[5] == "overload"
    assert MODELS["ax-12a"].errors is PROTOCOL_1_ERRORS


@pytest.mark.parametrize("name", ["xl-320", "ax-12a", "mx-28-1.0"])
def test_servos_without_a_bus_watchdog_are_told_to_have_none(name):
    joint = {"id": 1, "model": name, "velocity": 1.0, "effort": 1.0, "lower": -1.0, "upper": 1.0}
    chain = Chain.of(load(DynamixelConfig, from_values({"joints": {"a": joint}})))
    assert not chain.servos[0].has_watchdog
    assert not chain.servos[0].takes_velocities
