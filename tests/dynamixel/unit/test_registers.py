"""What the configuration wants in the registers, and what is in its way."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel.calibration import ServoCalibration
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.control_tables import ControlTable, control_table
from crtk_driver_dynamixel.joints import Chain, ChainServo
from crtk_driver_dynamixel.models import OperatingMode
from crtk_driver_dynamixel.registers import Setting, eeprom, obstacles, ram, watchdog_count
from crtk_driver_dynamixel.units import read_number, write_number
from crtk_drivers.config import from_values, load

JOINT: dict[str, Any] = {"id": 2, "model": "xm540-w270"}


def one(
    joint: dict[str, Any] | None = None, **keys: Any
) -> tuple[ChainServo, ControlTable, DynamixelConfig]:
    config = load(
        DynamixelConfig, from_values({"joints": {"lift": {**JOINT, **(joint or {})}}, **keys})
    )
    servo = Chain.of(config).servos[0]
    return servo, control_table(servo.units.model.number), config


def values(settings: tuple[Setting, ...]) -> dict[str, int]:
    return {setting.item.name: setting.value for setting in settings}


def test_eeprom_of_a_new_servo() -> None:
    servo, table, config = one()
    assert values(eeprom(servo, servo, table, config)) == {
        "operating_mode": 3,
        "drive_mode": 0,
        "secondary_id": 255,
        "return_delay_time": 0,
        "startup_configuration": 0,
    }
    assert all(s.item.eeprom for s in eeprom(servo, servo, table, config))


def test_eeprom_of_a_configured_one() -> None:
    servo, table, config = one(
        {"reverse": True, "mode": "current_based_position"}, return_delay=20e-6
    )
    found = ServoCalibration(joint="lift", bus="main", id=2, model="xm540-w270", homing_offset=-300)
    wanted = values(eeprom(servo, servo, table, config, found))
    assert wanted == {
        "operating_mode": 5,
        "drive_mode": 1,
        "secondary_id": 255,
        "return_delay_time": 10,
        "startup_configuration": 0,
        "homing_offset": -300,
    }
    other = values(eeprom(servo, servo, table, config, mode=OperatingMode.VELOCITY))
    assert other["operating_mode"] == 1


def test_what_is_null_is_left() -> None:
    servo, table, config = one(return_delay=None, status_return_level=None)
    assert "return_delay_time" not in values(eeprom(servo, servo, table, config))
    assert "status_return_level" not in values(ram(servo, table, config))


def test_shadows_take_the_goals_of_the_first_or_their_own() -> None:
    shadows = [
        {"id": 3, "sign": 1, "follow": "secondary_id", "reverse": True},
        {"id": 4, "sign": -1},
    ]
    config = load(DynamixelConfig, from_values({"joints": {"lift": {**JOINT, "shadows": shadows}}}))
    first, second, third = Chain.of(config).servos
    table = control_table(1120)
    assert values(eeprom(second, first, table, config))["secondary_id"] == 2
    assert values(eeprom(second, first, table, config))["drive_mode"] == 1
    assert values(eeprom(third, first, table, config))["secondary_id"] == 255


def test_ram() -> None:
    gains = {"position_p": 1500, "position_i": 0, "feedforward_1st": 10}
    servo, table, config = one(
        {
            "gains": gains,
            "profile_velocity": 1.0,
            "profile_acceleration": 1e-6,
            "current_limit": 1.0,
            "pwm_limit": 0.5,
        }
    )
    settings = ram(servo, table, config)
    assert values(settings) == {
        "status_return_level": 1,
        "position_p_gain": 1500,
        "position_i_gain": 0,
        "feedforward_1st_gain": 10,
        "profile_velocity": 42,
        "profile_acceleration": 1,  # 0 would be none at all
        "goal_current": 371,
        "goal_pwm": 442,
    }
    assert not any(s.item.eeprom for s in settings)
    bounded = values(ram(servo, table, config, {"current_limit": 100, "pwm_limit": 200}))
    assert (bounded["goal_current"], bounded["goal_pwm"]) == (100, 200)


def test_profiles_are_of_the_joint() -> None:
    servo, table, config = one({"gear": 2.0, "profile_velocity": 1.0, "mode": "extended_position"})
    assert values(ram(servo, table, config))["profile_velocity"] == 83
    servo, table, config = one({"profile_velocity": 0.0})
    assert values(ram(servo, table, config))["profile_velocity"] == 0


@pytest.mark.parametrize("model", ["ax-12a", "xl-320", "xl430-w250", "ph54-200-s500", "mx-28-1.0"])
def test_registers_that_a_model_lacks_are_left_out(model: str) -> None:
    servo, table, config = one({"model": model, "pwm_limit": 0.5})
    for setting in (*eeprom(servo, servo, table, config), *ram(servo, table, config)):
        assert table[setting.item.name] is setting.item
        assert read_number(write_number(setting.value, setting.item), setting.item) == setting.value


@given(st.integers(0, 255))
def test_only_the_bits_that_matter_are_changed(read: int) -> None:
    servo, table, config = one({"reverse": True})
    setting = next(s for s in eeprom(servo, servo, table, config) if s.item.name == "drive_mode")
    written = setting.written(read)
    assert written & 0b1101 == 0b0001
    assert written & ~0b1101 == read & ~0b1101
    assert setting.differs(read) is (read & 0b1101 != 0b0001)
    assert not setting.differs(written)


@pytest.mark.parametrize(
    ("seconds", "count"), [(0.0, 0), (0.001, 1), (0.02, 1), (0.1, 5), (0.101, 6), (2.54, 127)]
)
def test_watchdog(seconds: float, count: int) -> None:
    assert watchdog_count(seconds) == count


def test_obstacles() -> None:
    servo, _, _ = one({"lower": -1.0, "upper": 1.0, "current_limit": 2.0})
    free = {"min_position_limit": 0, "max_position_limit": 4095, "current_limit": 2047}
    assert obstacles(servo, free) == ()
    assert obstacles(servo, {}) == ()
    (text,) = obstacles(servo, {**free, "min_position_limit": 1500})
    assert "joint lift (servo 2 on main) takes goals from 1500 to 4095" in text
    assert "its range is 1396 to 2700" in text
    assert len(obstacles(servo, {**free, "max_position_limit": 2699})) == 1
    (text,) = obstacles(servo, {**free, "current_limit": 500})
    assert "limits its current to 1.345 A" in text
    extended, _, _ = one({"lower": -1.0, "upper": 1.0, "mode": "extended_position"})
    assert obstacles(extended, {**free, "min_position_limit": 1500}) == ()
