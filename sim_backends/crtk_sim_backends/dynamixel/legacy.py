"""Older servos: AX-12A, the MX series with its old firmware, both of protocol 1.0, and the XL-320 of 2.0.

Source: e-manual, control tables of AX-12A, MX-28/MX-64 (1.0) and XL-320. A joint has joint mode and wheel
mode (both angle limits 0; XL-320: Control Mode 1), MX multi-turn mode too (both 4095). As a wheel an MX keeps
a speed, and the others a share of their output. MX-64 and MX-106 exert Goal Torque, and heed no goal position
and no speed, while Torque Control Mode Enable (70) is 1.
"""

from __future__ import annotations

import math
from typing import Final

from typing_extensions import override

from crtk_sim_backends.dynamixel.drive import Mode
from crtk_sim_backends.dynamixel.models import Model
from crtk_sim_backends.dynamixel.packets import ALERT, Code, Error
from crtk_sim_backends.dynamixel.plant import Joint
from crtk_sim_backends.dynamixel.profile import by_velocity
from crtk_sim_backends.dynamixel.registers import Series
from crtk_sim_backends.dynamixel.servo import Answer, Servo

FASTER: Final = {250: 2_250_000, 251: 2_500_000, 252: 3_000_000}
"""Values of Baud Rate (4) of the MX series above the formula 2 000 000 / (value + 1)."""

STANDARD: Final = {1: 1_000_000, 9: 200_000, 16: 115_200, 34: 57_600, 103: 19_200, 207: 9_600}
"""Values of Baud Rate (4) for the rates that hosts have; the formula gives them within 3 %."""

VOLTAGE, ANGLE_LIMIT, OVERHEAT, OVERLOAD = 0, 1, 2, 5
"""Bits of the error byte, of Alarm LED (17) and of Shutdown (18)."""

XL320_BITS: Final = {OVERLOAD: 0, OVERHEAT: 1, VOLTAGE: 2}
"""Bits of Hardware Error Status (50) and Shutdown (18) of the XL-320."""

XL320_BAUD_RATES: Final = (9600, 57_600, 115_200, 1_000_000)

_TORQUE_MODE: Final = ("torque_control_mode_enable", "goal_torque")
_TORQUE_UNIT: Final = 0.0045  # A, of Goal Torque (71)

_FOREIGN_BITS: Final = {0: VOLTAGE, 2: OVERHEAT, 5: OVERLOAD}


def _signed_10(value: float, limit: int = 1023) -> int:
    """A value whose sign is bit 10: set clockwise, which counts down."""
    magnitude = min(limit, round(abs(value)))
    return magnitude | (0x400 if value < 0.0 and magnitude else 0)


class LegacyServo(Servo):
    """A servo of the AX or MX(1.0) series, or an XL-320."""

    def __init__(self, model: Model, firmware: int, joint: Joint, mount: int = 1) -> None:
        super().__init__(model, firmware, joint, mount)
        self._errors = 0
        self.started(joint.time)

    @override
    def derive(self) -> None:
        super().derive()
        value = self["baud_rate"]
        self.protocol = 2 if self._is_xl320 else 1
        if self._is_xl320:
            self.baud = XL320_BAUD_RATES[value]
            return
        self.baud = FASTER.get(value) or STANDARD.get(value) or 2_000_000 // (value + 1)

    @property
    def _is_xl320(self) -> bool:
        return self.model.series is Series.XL320

    @property
    @override
    def error_bits(self) -> int:
        if self._is_xl320:
            return ALERT if self["hardware_error_status"] else 0
        return self._errors

    @property
    def _mode(self) -> Mode:
        if self.get("torque_control_mode_enable"):
            return Mode.CURRENT
        limits = self["cw_angle_limit"], self["ccw_angle_limit"]
        is_wheel = self["control_mode"] == 1 if self._is_xl320 else limits == (0, 0)
        if is_wheel:
            return Mode.VELOCITY if self.model.series is Series.MX_LEGACY else Mode.PWM
        multi = self.model.series is Series.MX_LEGACY and limits == (4095, 4095)
        return Mode.EXTENDED_POSITION if multi else Mode.POSITION

    def _count(self, angle: float) -> float:
        units = self.model.units
        return angle / units.position + units.zero + self._turns

    @property
    @override
    def limits(self) -> tuple[float, float] | None:
        if self._mode is not Mode.POSITION:
            return None
        units = self.model.units
        low, high = self["cw_angle_limit"], self["ccw_angle_limit"]
        return (low - units.zero) * units.position, (high - units.zero) * units.position

    # Measured values

    @override
    def refresh(self, time: float, start: int = 0, end: int = 65536) -> None:
        drive, units = self.drive, self.model.units
        self.advance(time)
        angle, velocity, torque = self.sensed(time)
        self["present_position"] = self._present_position(angle)
        self["present_speed"] = _signed_10(velocity / units.velocity)
        share = torque / self.model.torque
        self["present_load"] = _signed_10(share * units.full_load)
        self["present_voltage"] = round(10.0 * self.volts)
        self["present_temperature"] = max(0, min(255, round(self.temperature)))
        self["moving"] = drive.mode is not None and (
            not drive.settled or abs(drive.velocity) > units.velocity
        )
        if "current" in self.table:
            unit = self.model.current_unit or 1.0
            self["current"] = max(0, min(4095, 2048 + round(share * self.model.amperes / unit)))
        if "realtime_tick" in self.table:
            self["realtime_tick"] = int(time * 1000.0) % 32768
        if self.stuffing is not None:
            self["present_position"] = next(self.stuffing)[2] & 0x7FFF

    @override
    def acted(self, watchdog: bool, overload: bool) -> None:
        if overload:
            self.force_error(OVERLOAD)

    @override
    def watch_limits(self) -> None:
        if not self["min_voltage_limit"] <= round(10.0 * self.volts) <= self["max_voltage_limit"]:
            self.force_error(VOLTAGE)
        if self.temperature > self["temperature_limit"]:
            self.force_error(OVERHEAT)

    def _present_position(self, angle: float) -> int:
        count = round(self._count(angle))
        if self._mode is Mode.EXTENDED_POSITION:
            return max(-32768, min(32767, count + self.get("multi_turn_offset")))
        if self.model.series is not Series.MX_LEGACY:
            return max(0, min(1023, count))  # beyond 300 degrees there is nothing to measure
        return count % self.model.units.counts

    @override
    def heard(self, time: float) -> None:
        """There is no watchdog."""

    @override
    def force_error(self, bit: int) -> None:
        """`bit` is one of protocol 2.0 or 1.0, which agree on those that both have."""
        own = _FOREIGN_BITS.get(bit, OVERLOAD)
        if self._is_xl320:
            self["hardware_error_status"] |= 1 << XL320_BITS[own]
        self._errors |= 1 << (XL320_BITS[own] if self._is_xl320 else own)
        if self["shutdown"] & self._errors:
            self["torque_enable"] = self["torque_limit"] = 0
            self.drive.switch(None, self.joint.time)

    # Writes

    @override
    def refused(self, name: str, value: int) -> Error:
        if name == "goal_position" and self._mode is Mode.POSITION:
            inside = self["cw_angle_limit"] <= value <= self["ccw_angle_limit"]
            return Error.NONE if inside else Error.LIMIT
        return Error.NONE

    @override
    def written(self, name: str, time: float) -> None:
        if name == "torque_enable" and not self.torque_enabled:
            self.drive.switch(None, time)
        elif name in _TORQUE_MODE and not self.torque_enabled:
            pass  # nobody says that these turn torque on
        elif name in (
            *("goal_position", "moving_speed", "torque_enable", "torque_limit"),
            *_TORQUE_MODE,
        ):
            if not self["shutdown"] & self._errors:
                self._pursue(time, name)
            else:
                self["torque_enable"] = 0

    def _pursue(self, time: float, name: str) -> None:
        """Go for the goal; writing Goal Position or Moving Speed turns torque on by itself."""
        drive, units, mode = self.drive, self.model.units, self._mode
        self["torque_enable"] = 1
        if drive.mode is not mode:
            drive.switch(mode, time)
        drive.torque_limit = self.model.torque * self["torque_limit"] / 1023
        speed = self["moving_speed"]
        if mode is Mode.CURRENT:
            torque = self["goal_torque"]
            amperes = (-1 if torque & 0x400 else 1) * (torque & 0x3FF) * _TORQUE_UNIT
            drive.push(amperes * self.model.torque / self.model.amperes)
        elif mode is Mode.VELOCITY:
            way = -1 if speed & 0x400 else 1
            drive.turn(way * (speed & 0x3FF) * units.velocity, self._acceleration, time)
        elif mode is Mode.PWM:
            drive.push((-1 if speed & 0x400 else 1) * (speed & 0x3FF) / 1023)
        elif name in ("goal_position", "moving_speed", "torque_control_mode_enable"):
            position, velocity, _ = drive.trajectory(time)
            goal = (self["goal_position"] - units.zero - self._turns) * units.position
            limit = (speed & 0x3FF) * units.velocity
            drive.follow(by_velocity(position, velocity, goal, limit, self._acceleration), time)

    @property
    def _acceleration(self) -> float:
        value = self.get("goal_acceleration")
        return (
            0.0
            if value == 0 or math.isnan(self.model.units.acceleration)
            else (value * self.model.units.acceleration)
        )

    # Other instructions

    @override
    def execute(self, code: int, parameters: bytes, time: float, *, broadcast: bool) -> Answer:
        """The AX series knows no reboot."""
        if code == Code.REBOOT and self.model.series is Series.AX:
            return Error.INSTRUCTION, b""
        return super().execute(code, parameters, time, broadcast=broadcast)

    @override
    def started(self, time: float) -> None:
        self._errors = 0
        if self._is_xl320:
            self["hardware_error_status"] = 0
        self._turns = 0
        units = self.model.units
        count = round(self._count(self.drive.angle))
        if self.model.series is Series.MX_LEGACY:
            self._turns = -(count // units.counts) * units.counts
        self["torque_limit"] = self["max_torque"]
        self["goal_position"] = self._present_position(self.drive.angle)
