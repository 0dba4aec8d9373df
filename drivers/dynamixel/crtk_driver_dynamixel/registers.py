"""What a configuration wants in the registers of each servo, and what it finds in their way.

Nothing is read or written here: a `Setting` is compared with what was read, so that EEPROM is written only
where it differs. Registers that a model does not have are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from crtk_driver_dynamixel.calibration import ServoCalibration
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.control_tables import ControlTable, Item
from crtk_driver_dynamixel.joints import ChainServo, servo_range
from crtk_driver_dynamixel.models import OperatingMode
from crtk_driver_dynamixel.servo_state import encoder_turn, position_limits

REVERSE: Final = 0x01
TIME_BASED: Final = 0x04
TORQUE_ON_BY_GOAL: Final = 0x08
"""Bits of Drive Mode (10): counting the other way, profiles by time instead of velocity, and torque that
comes on by itself with a goal, which would undo `disable`."""
TORQUE_ON_AT_START: Final = 0x01
"""Bit of Startup Configuration (60): a servo whose supply dips would come back with torque, without watchdog
and gains, and follow the goals of a driver that has not noticed."""
NO_SECONDARY_ID: Final = 255
WATCHDOG_STEP: Final = 0.02
"""Unit of Bus Watchdog (98), in s."""
MOST_WATCHDOG: Final = 127
RETURN_DELAY_STEP: Final = 2e-6
"""Unit of Return Delay Time (9), in s."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A register and the value that it should have.

    Attributes:
        mask: the bits that matter; the others stay as they are. None: all of them.
    """

    item: Item
    value: int
    mask: int | None = None

    def differs(self, read: int) -> bool:
        """Whether a register that reads so has to be written."""
        return self.written(read) != read

    def written(self, read: int) -> int:
        """Return what to write into a register that reads so."""
        return self.value if self.mask is None else read & ~self.mask | self.value & self.mask


def eeprom(
    servo: ChainServo,
    first: ChainServo,
    table: ControlTable,
    config: DynamixelConfig,
    calibration: ServoCalibration | None = None,
    mode: OperatingMode | None = None,
) -> tuple[Setting, ...]:
    """Return what should be in the EEPROM of a servo; written only while its torque is off.

    Args:
        servo: in its chain.
        first: the first servo of its joint; itself if it is no shadow.
        calibration: its own; without one its homing offset stays as it is.
        mode: operating mode; that of the configuration for positions if None.
    """
    follows = servo.follow == "secondary_id"
    drive_mode = REVERSE if servo.reverse else 0
    wanted: list[tuple[str, int | None, int | None]] = [
        ("operating_mode", servo.units.mode if mode is None else mode, None),
        ("control_mode", servo.units.model.family.joint_mode, None),
        ("drive_mode", drive_mode, REVERSE | TIME_BASED | TORQUE_ON_BY_GOAL),
        ("secondary_id", first.id if follows else NO_SECONDARY_ID, None),
        ("return_delay_time", _return_delay(config), None),
        ("startup_configuration", 0, TORQUE_ON_AT_START),
        ("homing_offset", None if calibration is None else calibration.homing_offset, None),
    ]
    return tuple(_settings(table, wanted))


def ram(
    servo: ChainServo,
    table: ControlTable,
    config: DynamixelConfig,
    read: Mapping[str, int] | None = None,
) -> tuple[Setting, ...]:
    """Return what should be in the RAM of a servo: after power-on, reboot and every change of mode.

    Args:
        read: registers that were read, by name; current_limit, pwm_limit and max_torque bound what is asked
            for.
    """
    known = {} if read is None else read
    own = servo.config
    gains = {f"{name}_gain": value for name, value in own.gains.model_dump().items()}
    wanted: list[tuple[str, int | None, int | None]] = [
        ("status_return_level", config.status_return_level, None),
        *((name, value, None) for name, value in gains.items()),
        ("profile_acceleration", _profile(servo, own.profile_acceleration, "acceleration"), None),
        ("profile_velocity", _profile(servo, own.profile_velocity, "velocity"), None),
        ("goal_current", _bounded(servo.current_limit, known.get("current_limit")), None),
        ("goal_pwm", _bounded(servo.pwm_limit, known.get("pwm_limit")), None),
        # What another program left in older servos would make them crawl, or push on and on.
        ("moving_speed", _profile(servo, own.profile_velocity, "velocity"), None),
        ("torque_limit", _bounded(servo.pwm_limit, known.get("max_torque")), None),
        ("torque_control_mode_enable", 0, None),
        ("goal_acceleration", 0, None),
    ]
    return tuple(_settings(table, wanted))


def watchdog_count(seconds: float) -> int:
    """Return the count of Bus Watchdog (98) for a time, rounded up; 0 switches it off."""
    return min(MOST_WATCHDOG, math.ceil(seconds / WATCHDOG_STEP - 1e-9))


def obstacles(servo: ChainServo, read: Mapping[str, int]) -> tuple[str, ...]:
    """Return what in the registers of a servo keeps it from doing what the configuration promises.

    A goal beyond its own limits is refused by a servo (error 6, Data Limit), and nothing moves.

    Args:
        read: registers by name; those that are not there are not judged.
    """
    found = []
    ends = servo_range(servo.config)
    low, high = sorted(servo.units.count(end) for end in ends)
    family = servo.units.model.family
    least, most = position_limits(read, family)
    is_limited = servo.units.mode is OperatingMode.POSITION
    if least == most and "cw_angle_limit" in read:
        found.append(
            f"{servo.place} is in wheel or multi-turn mode (both of its angle limits are {least}), which "
            f"takes no positions: set CW Angle Limit (6) to {family.lowest} and CCW Angle Limit (8) to "
            f"{family.highest}"
        )
    elif is_limited and not (least - 0.5 <= low and high <= most + 0.5):
        found.append(
            f"{servo.place} takes goals from {least} to {most} (Min and Max Position Limit), and its range "
            f"is {low:.0f} to {high:.0f}: narrow lower and upper, or widen the limits in the servo "
            "(crtk-driver dynamixel limits)"
        )
    elif is_limited:
        found += _beyond_the_turn(servo, read, low, high)
    limit = servo.config.current_limit
    register = read.get("current_limit")
    unit = servo.units.model.current_unit
    if limit is not None and register is not None and limit > register * unit * (1.0 + 1e-9):
        found.append(
            f"{servo.place} limits its current to {register * unit:.3f} A (Current Limit), below "
            f"current_limit {limit:g} A: lower the key, or raise the limit in the servo "
            "(crtk-driver dynamixel limits)"
        )
    return tuple(found)


def _beyond_the_turn(
    servo: ChainServo, read: Mapping[str, int], low: float, high: float
) -> Iterator[str]:
    """Yield that a range, in counts, goes over the end of the encoder's turn, where a servo would turn back.

    The count at the end belongs to two turns, and may be in the range.
    """
    units = servo.units
    first, last = encoder_turn(read, units.model.family)
    if first - 1 <= low and high <= last + 1:
        return
    least, most = position_limits(read, units.model.family)
    ends = max(low, first, least), min(high, last, most)
    possible = " to ".join(f"{end:.4f}" for end in sorted(map(units.position, ends)))
    homing = read.get("homing_offset", 0)
    yield (
        f"{servo.place} counts from {first} to {last} in position mode, with its Homing Offset (20) of "
        f"{homing}, and its range is {low:.0f} to {high:.0f}: beyond, it would make a whole turn when it "
        f"gets torque. Narrow lower and upper to {possible} rad, calibrate without --eeprom, or set mode to "
        "extended_position"
    )


def _settings(
    table: ControlTable, wanted: list[tuple[str, int | None, int | None]]
) -> Iterator[Setting]:
    for name, value, mask in wanted:
        if value is not None and name in table:
            yield Setting(table[name], int(value), mask)


def _return_delay(config: DynamixelConfig) -> int | None:
    delay = config.return_delay
    return None if delay is None else round(delay / RETURN_DELAY_STEP)


def _profile(servo: ChainServo, value: float, quantity: str) -> int:
    """Return a count of a profile register, where 0 means without limit and so is never rounded to."""
    family = servo.units.model.family
    unit = float(getattr(family, f"{quantity}_unit"))
    if value == 0.0 or math.isnan(unit):
        return 0
    count = round(value * servo.units.gear / unit)
    return max(1, min(count, family.highest_profile))


def _bounded(value: int | None, limit: int | None) -> int | None:
    return value if value is None or limit is None else min(value, limit)
