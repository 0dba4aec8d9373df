"""Servos with the control table of protocol 2.0: X series, MX(2.0) and P series.

Source: e-manual, control tables of XM430-W350, XL330-M288, MX-64(2.0) and PH54-200-S500-R; the sections
that matter are named at the functions.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from typing import Final

from typing_extensions import override

from crtk_sim_backends.dynamixel.drive import CURRENT_MODES, POSITION_MODES, Mode
from crtk_sim_backends.dynamixel.models import Model
from crtk_sim_backends.dynamixel.packets import ALERT, Error
from crtk_sim_backends.dynamixel.plant import Joint
from crtk_sim_backends.dynamixel.profile import Profile, by_time, by_velocity
from crtk_sim_backends.dynamixel.registers import (
    BACKUP_SINCE,
    FAST_READ_SINCE,
    RAM_OFFSET,
    Access,
    Series,
)
from crtk_sim_backends.dynamixel.servo import Servo

BAUD_RATES: Final = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""By the value of Baud Rate (8)."""

VOLTAGE, OVERHEAT, ENCODER, SHOCK, OVERLOAD = 0, 2, 3, 4, 5
"""Bits of Hardware Error Status (70) and Shutdown (63)."""

REVERSE: Final = 0x01
TIME_BASED: Final = 0x04
TORQUE_BY_GOAL: Final = 0x08
"""Bits of Drive Mode (10)."""

MULTI_TURN_CLEAR: Final = bytes((0x01, 0x44, 0x58, 0x4C, 0x22))
STORE: Final = bytes((0x01, 0x43, 0x54, 0x52, 0x4C))
RESTORE: Final = bytes((0x02, 0x43, 0x54, 0x52, 0x4C))

_PRESENT_AT: Final = 120  # from Realtime Tick to Present Temperature
_PRESENT: Final = struct.Struct("<HBBhhiiiiHB")
_MEASURED_AT: Final = 126  # Present Current, Velocity and Position, which are what is read most
_MEASURED: Final = struct.Struct("<hii")
_WATCHDOG_UNIT: Final = 0.020  # s
_TRIPPED: Final = -1
_TICKS: Final = 32768
_MULTI_TURN_LIMIT: Final = 1_048_575
_HOMING_LIMIT: Final = 1024  # counts, in position mode
_FOLLOWING_ERROR: Final = math.radians(5.0)
_IN_POSITION: Final = math.radians(1.0)
_GOALS: Final = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")
_LIMITS: Final = {
    "goal_velocity": "velocity_limit",
    "goal_current": "current_limit",
    "goal_pwm": "pwm_limit",
}
_GOAL_OF: Final[Mapping[Mode, str]] = {
    Mode.CURRENT: "goal_current",
    Mode.VELOCITY: "goal_velocity",
    Mode.POSITION: "goal_position",
    Mode.EXTENDED_POSITION: "goal_position",
    Mode.CURRENT_BASED_POSITION: "goal_position",
    Mode.PWM: "goal_pwm",
}
_RESET_BY_MODE: Final = (
    *("velocity_i_gain", "velocity_p_gain", "position_d_gain", "position_i_gain"),
    *("position_p_gain", "feedforward_2nd_gain", "feedforward_1st_gain"),
    *("profile_velocity", "profile_acceleration"),
)


def _small(value: float) -> int:
    return max(-32768, min(32767, round(value)))


def _wide(value: float) -> int:
    return (round(value) + 2**31) % 2**32 - 2**31


class ModernServo(Servo):
    """A servo of the X, MX(2.0) or P series."""

    def __init__(self, model: Model, firmware: int, joint: Joint, mount: int = 1) -> None:
        super().__init__(model, firmware, joint, mount)
        self._offset = RAM_OFFSET.get(model.series, 0)
        self._shut_down = False
        self._aside = 0.0  # rad beside its goal, by a defect, until it has another one
        self._effects: Mapping[str, Callable[[float], None]] = {
            "torque_enable": self._torque,
            "operating_mode": self._mode_changed,
            "bus_watchdog": self._arm_watchdog,
            "position_p_gain": self._set_limits,
            "pwm_limit": self._set_limits,
            "current_limit": self._set_limits,
        } | {name: self._goal_effect(name) for name in _GOALS}
        self.started(joint.time)

    # Identity and communication

    measured = frozenset(
        {"realtime_tick", "moving", "moving_status", "present_pwm", "present_current"}
        | {"present_load", "present_velocity", "present_position", "velocity_trajectory"}
        | {"position_trajectory", "present_input_voltage", "present_temperature"}
    )

    mode: Mode

    @override
    def derive(self) -> None:
        super().derive()
        kind = self["protocol_type"]
        self.protocol = kind if kind in (1, 2) else 0  # 20 to 22: remote control receivers
        self.baud = BAUD_RATES[self["baud_rate"]]
        shadowed = self["secondary_id"]
        self.secondary = shadowed if shadowed <= 252 else None
        self.mode = Mode(self["operating_mode"])
        self._goal = _GOAL_OF[self.mode]
        self._way = -1 if self["drive_mode"] & REVERSE else 1
        self._homing = self._homing_in_force()
        model, units = self.model, self.model.units
        unit = model.current_unit
        full = units.full_load if unit is None else model.amperes / unit
        self._per_angle = self._way / units.position
        self._per_velocity = self._way / units.velocity
        self._per_torque = self._way * full / model.torque

    @property
    @override
    def error_bits(self) -> int:
        return ALERT if self["hardware_error_status"] else 0

    @property
    @override
    def legacy_bits(self) -> int:
        return self["hardware_error_status"] & 0x25

    @property
    def has_fast_read(self) -> bool:
        """Whether it knows fast sync and fast bulk read."""
        since = FAST_READ_SINCE.get(self.model.series)
        return since is not None and self.firmware >= since

    # Between counts and the horn

    def _homing_in_force(self) -> int:
        """Homing Offset (20): in position mode only what lies within a quarter turn counts."""
        offset = self["homing_offset"]
        limited = self.mode is Mode.POSITION and self.model.series is not Series.P
        return 0 if limited and abs(offset) > _HOMING_LIMIT else offset

    def _count(self, angle: float) -> float:
        """Position in counts for an angle of the horn."""
        return self._per_angle * angle + self.model.units.zero + self._turns + self._homing

    def _angle(self, count: float) -> float:
        """Angle of the horn for a position in counts."""
        return (count - self.model.units.zero - self._turns - self._homing) / self._per_angle

    def _forget_turns(self) -> None:
        """Count from within one turn again, as the encoder does after power-on."""
        units = self.model.units
        self._turns = 0
        count = round(self._count(self.drive.angle)) - self._homing
        lowest = units.zero - units.counts // 2
        self._turns = -((count - lowest) // units.counts) * units.counts

    # Measured values

    @override
    def refresh(self, time: float, start: int = 0, end: int = 65536) -> None:
        drive, units, offset = self.drive, self.model.units, self._offset
        self.advance(time)
        way = self._way
        angle, speed, torque = self.sensed(time)
        velocity = self._per_velocity * speed
        if self.stuffing is not None:
            measured = next(self.stuffing)
        else:
            effort = _small(self._per_torque * torque)
            measured = effort, _wide(velocity), _wide(self._count(angle))
        if start >= _MEASURED_AT + offset and end <= _MEASURED_AT + _MEASURED.size + offset:
            _MEASURED.pack_into(self.memory, _MEASURED_AT + offset, *measured)
            return
        aim, aim_velocity, _ = drive.trajectory(time)
        _PRESENT.pack_into(
            self.memory,
            _PRESENT_AT + offset,
            int(time * 1000.0) % _TICKS,
            abs(velocity) > self["moving_threshold"],
            self._moving_status(time),
            _small(way * drive.output * units.full_pwm),
            *measured,
            _wide(self._per_velocity * aim_velocity),
            _wide(self._count(aim)),
            round(self.volts * 10.0),
            max(0, min(255, round(self.temperature))),
        )

    def _moving_status(self, time: float) -> int:
        drive = self.drive
        if not drive.positions:
            return 0
        passed = time - drive.since
        aim = drive.profile.at(passed)[0]
        status = drive.profile.kind
        if passed < drive.profile.duration:
            status |= 0x02
        elif abs(drive.profile.goal - drive.angle) < _IN_POSITION:
            status |= 0x01
        if abs(aim - drive.angle) > _FOLLOWING_ERROR:
            status |= 0x08
        return status

    @override
    def acted(self, watchdog: bool, overload: bool) -> None:
        if watchdog:
            self["bus_watchdog"] = _TRIPPED
            for name in ("profile_velocity", "profile_acceleration"):
                self[name] = 0
        if overload:
            self.force_error(OVERLOAD)

    @override
    def watch_limits(self) -> None:
        volts = round(10.0 * self.volts)
        if not self["min_voltage_limit"] <= volts <= self["max_voltage_limit"]:
            self.force_error(VOLTAGE)
        if self.temperature > self["temperature_limit"]:
            self.force_error(OVERHEAT)

    @override
    def force_error(self, bit: int) -> None:
        """What Shutdown (63) names takes the torque away until a reboot."""
        self["hardware_error_status"] |= 1 << bit
        if self["shutdown"] >> bit & 1 and not self._shut_down:
            self._shut_down = True
            self["torque_enable"] = 0
            self._torque(self.joint.time)

    # Writes

    @override
    def refused(self, name: str, value: int) -> Error:
        if name in _GOALS and self["bus_watchdog"] == _TRIPPED:
            return Error.RANGE
        if name == "operating_mode":
            modes = {*Mode} - (CURRENT_MODES if self.model.current_unit is None else set())
            if self.model.series is Series.P:
                modes -= {Mode.CURRENT_BASED_POSITION}
            return Error.NONE if value in modes else Error.RANGE
        limit = _LIMITS.get(name)
        if limit is not None and abs(value) > self[limit]:
            return Error.LIMIT
        if name == "goal_position":
            low, high = self._goal_limits()
            return Error.NONE if low <= value <= high else Error.LIMIT
        return Error.NONE

    def _goal_limits(self) -> tuple[int, int]:
        if self.mode is Mode.POSITION:
            return self["min_position_limit"], self["max_position_limit"]
        if self.model.series is Series.P:
            return -(2**31), 2**31 - 1
        return -_MULTI_TURN_LIMIT, _MULTI_TURN_LIMIT

    @property
    @override
    def limits(self) -> tuple[float, float] | None:
        if self.mode is not Mode.POSITION:
            return None
        one, other = map(self._angle, self._goal_limits())
        return min(one, other), max(one, other)

    @override
    def written(self, name: str, time: float) -> None:
        effect = self._effects.get(name)
        if effect is not None:
            effect(time)

    def _goal_effect(self, name: str) -> Callable[[float], None]:
        def effect(time: float) -> None:
            by_goal = self["drive_mode"] & TORQUE_BY_GOAL and name == self._goal
            if by_goal and not self.torque_enabled and not self._shut_down:
                self["torque_enable"] = 1
                self._torque(time)
            elif self.drive.mode is not None:
                if name in ("goal_pwm", "goal_current"):
                    self._set_limits(time)
                if name == self._goal:
                    self._aside = 0.0
                    self._pursue(time)

        return effect

    def _torque(self, time: float) -> None:
        """Torque Enable (64). A goal that was left behind is pursued at once: real servos jump too."""
        if not self.torque_enabled or self._shut_down:
            self["torque_enable"] = 0
            self.drive.switch(None, time)
            self.drive.set_alarm(math.inf)
            return
        if self.drive.mode is self.mode:
            return
        if self.mode is Mode.POSITION:
            self._forget_turns()
        self.drive.switch(self.mode, time)
        self._set_limits(time)
        self._aside = self.defects.jump_on_enable if self.defects else 0.0
        self._pursue(time)
        self._feed_watchdog(time)

    def _pursue(self, time: float) -> None:
        """Go for the goal of the present mode."""
        drive, units, way, mode = self.drive, self.model.units, self._way, self.mode
        if drive.positions:
            goal = self._angle(self["goal_position"]) + self._aside
            if self.defects:
                goal += self.defects.following_offset
            drive.follow(self._profile(goal, time), time)
        elif mode is Mode.VELOCITY:
            acceleration = self["profile_acceleration"]
            velocity = way * self["goal_velocity"] * units.velocity
            slope = acceleration * units.acceleration
            if self["drive_mode"] & TIME_BASED:
                change = abs(velocity - drive.trajectory(time)[1])
                slope = change / (acceleration * 1e-3) if acceleration else 0.0
            drive.turn(velocity, slope, time)
        elif mode is Mode.CURRENT:
            drive.push(way * self._torque_of(self["goal_current"]))
        else:
            drive.push(way * self["goal_pwm"] / units.full_pwm)

    def _profile(self, goal: float, time: float) -> Profile:
        drive, units = self.drive, self.model.units
        position, velocity, _ = drive.trajectory(time)
        acceleration, limit = self["profile_acceleration"], self["profile_velocity"]
        if self["drive_mode"] & TIME_BASED:
            return by_time(position, velocity, goal, limit * 1e-3, acceleration * 1e-3)
        return by_velocity(
            position, velocity, goal, limit * units.velocity, acceleration * units.acceleration
        )

    def _torque_of(self, current: int) -> float:
        """Torque of a current in counts, N·m."""
        unit = self.model.current_unit or 0.0
        return current * unit * self.model.torque / self.model.amperes

    def _set_limits(self, time: float) -> None:
        drive = self.drive
        drive.pwm_limit = self["pwm_limit"] / self.model.units.full_pwm
        drive.torque_limit = math.inf
        if self.model.current_unit is not None:
            drive.torque_limit = self._torque_of(self["current_limit"])
            if self.mode is Mode.CURRENT_BASED_POSITION:
                drive.torque_limit = self._torque_of(abs(self["goal_current"]))
        if self.mode in POSITION_MODES and self.mode is not Mode.CURRENT_BASED_POSITION:
            drive.pwm_limit = min(
                drive.pwm_limit, abs(self["goal_pwm"]) / self.model.units.full_pwm
            )
        factory = self.table["position_p_gain"].default
        drive.stiffness = min(4.0, self["position_p_gain"] / factory)
        self.joint.wake()

    def _mode_changed(self, time: float) -> None:
        """Operating Mode (11): gains, profile and goals become those of the mode."""
        for name in _RESET_BY_MODE:
            self[name] = self.table[name].default
        if self.mode is Mode.POSITION:
            self._forget_turns()
        self._reset_goals()

    def _reset_goals(self) -> None:
        self["goal_pwm"] = self["pwm_limit"]
        if "goal_current" in self.table:
            self["goal_current"] = 0 if self.mode is Mode.CURRENT else self["current_limit"]
        if self.mode is Mode.PWM:
            self["goal_pwm"] = 0
        self["goal_velocity"] = 0
        self["goal_position"] = _wide(self._count(self.drive.angle))

    # Bus Watchdog (98)

    @override
    def heard(self, time: float) -> None:
        if self.drive.alarm < math.inf:
            self.advance(time)
            self._feed_watchdog(time)

    def _arm_watchdog(self, time: float) -> None:
        self.drive.set_alarm(math.inf)
        self._feed_watchdog(time)

    def _feed_watchdog(self, time: float) -> None:
        value = self["bus_watchdog"]
        if self.defects and self.defects.ignores_watchdog:
            return
        if value > 0 and self.torque_enabled:
            self.drive.set_alarm(time + value * _WATCHDOG_UNIT)

    # Other instructions

    @override
    def started(self, time: float) -> None:
        self._shut_down = False
        self["hardware_error_status"] = 0
        self._forget_turns()
        self._reset_goals()
        startup = self.get("startup_configuration")
        if startup & 2 and self._backup is not None:
            self._restore()
        if startup & 1:
            self["torque_enable"] = 1
            self._torque(time)

    @override
    def clear(self, parameters: bytes, time: float) -> Error:
        """Clear (0x10): full turns are forgotten, if it stands still."""
        if parameters != MULTI_TURN_CLEAR:
            return Error.RANGE
        self.refresh(time)
        if abs(self._per_velocity * self.drive.velocity) > self["moving_threshold"]:
            return Error.RESULT_FAIL  # it moves, by its register Moving (122)
        self._forget_turns()
        if self.drive.positions:
            self["goal_position"] = _wide(self._count(self.drive.angle))
            self.drive.stand(time)
        return Error.NONE

    @override
    def back_up(self, parameters: bytes, time: float) -> Error:
        """Control Table Backup (0x20): keep RAM over power-off, or take it back and reboot."""
        since = BACKUP_SINCE.get(self.model.series)
        if since is None or self.firmware < since:
            return Error.INSTRUCTION
        if parameters not in (STORE, RESTORE):
            return Error.RANGE
        if self.torque_enabled or (parameters == RESTORE and self._backup is None):
            return Error.RESULT_FAIL
        if parameters == STORE:
            self._backup = bytes(self.memory)
            self["backup_ready"] = 1
            return Error.NONE
        self.reboot(time)
        self._restore()
        return Error.NONE

    def _restore(self) -> None:
        assert self._backup is not None
        self["backup_ready"] = 1
        for register in self.table:
            kept = register.name in ("torque_enable", "goal_position")
            if register.access in (Access.RAM, Access.LOCKED) and not kept:
                at = slice(register.address, register.address + register.size)
                self.memory[at] = self._backup[at]
