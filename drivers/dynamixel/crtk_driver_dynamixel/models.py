"""What is known of each model: units, modes, ratings, and the texts of its errors.

Sources: the e-manual (https://emanual.robotis.com/docs/en/dxl/), pages and specifications of each model;
torque constants are stall torque by stall current at the recommended voltage, unless said otherwise.
A model that is not here has no units that could be trusted, and is refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from types import MappingProxyType
from typing import Final

from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.near_names import near_names

TURN: Final = 2.0 * math.pi
RPM: Final = TURN / 60.0
"""One revolution per minute, in rad/s."""


class OperatingMode(IntEnum):
    """Values of the register Operating Mode (11)."""

    CURRENT = 0
    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    CURRENT_BASED_POSITION = 5
    PWM = 16


GOALS: Final[Mapping[OperatingMode, str]] = MappingProxyType(
    {
        OperatingMode.CURRENT: "goal_current",
        OperatingMode.VELOCITY: "goal_velocity",
        OperatingMode.PWM: "goal_pwm",
    }
)
"""Register that a setpoint goes to; in the modes for positions it is Goal Position."""

_ALL_MODES: Final = frozenset(OperatingMode)
_NEEDS_CURRENT: Final = frozenset({OperatingMode.CURRENT, OperatingMode.CURRENT_BASED_POSITION})
_NO_CURRENT_BASED: Final = _ALL_MODES - {OperatingMode.CURRENT_BASED_POSITION}
_POSITIONS_ONLY: Final = frozenset({OperatingMode.POSITION})
"""Of the older series: their wheel mode takes a share of the output (AX, XL-320), or is set by the limits."""


@dataclass(frozen=True, slots=True)
class Family:
    """What models of one series share. Units are SI for one count.

    Attributes:
        protocol: that they speak when they are new.
        modes: of those that measure current; the others lack the modes that need it.
        counts: of one turn of the output, at `position_unit` each.
        zero: the count in the middle of the range, which is angle 0 here.
        position_unit: rad.
        lowest, highest: counts that a goal may have in position mode.
        turns: counts from zero to either end of the range in the modes of several turns; 0: no such mode.
        velocity_unit: rad/s.
        acceleration_unit: rad/s²; NaN if the series has no profiles.
        highest_profile: greatest count of Profile Velocity and Profile Acceleration, or of Moving Speed.
        full_pwm: count of 100 %, of PWM or of Torque Limit.
        homing_limit: largest homing offset that position mode takes, in counts; 0 if there is no such
            register or its limits are not known.
        fast_read_since: first firmware with fast sync and fast bulk read; None: never.
        restarts: whether it knows the instruction Reboot.
        has_watchdog: whether it has the register Bus Watchdog.
        joint_mode: what its Control Mode (11) must hold; None if it has no such register.
        is_older: it has the registers of the older servos: Moving Speed and Torque Limit, and no drive mode,
            secondary id or profiles. It takes torque by itself when it is sent a goal.
    """

    name: str
    protocol: int
    modes: frozenset[OperatingMode]
    counts: int
    zero: int
    position_unit: float
    lowest: int
    highest: int
    turns: int
    velocity_unit: float
    acceleration_unit: float
    highest_profile: int
    full_pwm: int
    homing_limit: int
    fast_read_since: int | None
    restarts: bool = True
    has_watchdog: bool = True
    joint_mode: int | None = None
    is_older: bool = False

    @property
    def has_dead_zone(self) -> bool:
        """Whether it measures less than a whole turn: beyond, it tells one of the ends."""
        return self.counts * self.position_unit < 0.9 * TURN

    def homing_in_force(self, offset: int) -> int:
        """Return what a homing offset adds to positions in position mode, in counts: 0 beyond its limit."""
        return 0 if self.homing_limit and abs(offset) > self.homing_limit else offset


def _x(name: str, fast_read_since: int | None) -> Family:
    return Family(
        name=name,
        protocol=2,
        modes=_ALL_MODES,
        counts=4096,
        zero=2048,
        position_unit=TURN / 4096,
        lowest=0,
        highest=4095,
        turns=1_048_575,
        velocity_unit=0.229 * RPM,
        acceleration_unit=214.577 * TURN / 3600.0,
        highest_profile=32_767,
        full_pwm=885,
        homing_limit=1024,
        fast_read_since=fast_read_since,
    )


def _p(name: str, counts: int) -> Family:
    return Family(
        name=name,
        protocol=2,
        modes=_NO_CURRENT_BASED,
        counts=counts,
        zero=0,
        position_unit=TURN / counts,
        lowest=-counts // 2,
        highest=counts // 2,
        turns=2**31 - 1,
        velocity_unit=0.01 * RPM,
        acceleration_unit=TURN / 3600.0,
        highest_profile=2**31 - 1,
        full_pwm=2009,
        homing_limit=0,
        fast_read_since=12,
    )


def _joint_and_wheel(name: str, counts: int, unit: float, velocity: float, turns: int) -> Family:
    return Family(
        name=name,
        protocol=1,
        modes=_POSITIONS_ONLY,
        counts=counts,
        zero=counts // 2,
        position_unit=unit,
        lowest=0,
        highest=counts - 1,
        turns=turns,
        velocity_unit=velocity * RPM,
        acceleration_unit=math.nan,
        highest_profile=1023,
        full_pwm=1023,
        homing_limit=0,
        fast_read_since=None,
        has_watchdog=False,
        is_older=True,
    )


X: Final = _x("X", 45)
X330: Final = _x("X330", 46)
X2: Final = _x("2X", None)
MX: Final = _x("MX(2.0)", None)
PH54: Final = _p("PH54", 1_003_846)
PH42: Final = _p("PH42", 607_500)
PM54: Final = _p("PM54", 502_834)
PM42: Final = _p("PM42", 526_374)
AX: Final = replace(
    _joint_and_wheel("AX", 1024, math.radians(300.0) / 1023, 0.111, 0), restarts=False
)
XL320: Final = replace(AX, name="XL-320", protocol=2, restarts=True, joint_mode=2)
MX_1: Final = _joint_and_wheel("MX(1.0)", 4096, TURN / 4096, 0.114, 28_672)
MX_12: Final = replace(MX_1, name="MX-12W", velocity_unit=0.916 * RPM)


@dataclass(frozen=True, slots=True)
class Model:
    """One model.

    Attributes:
        name: of the e-manual in lower case, without the letter of its plug (-T, -R).
        number: its model number.
        current_unit: A for one count; NaN if it reports a load instead.
        current_limit: greatest count of the register Current Limit; 0 if it has none or it is not known.
        voltage: least and greatest voltage of its supply by its registers, in V.
        no_load_speed: at the recommended voltage, in rad/s; NaN if not known.
        stall_torque: at that voltage, in N·m (P series: continuous torque); NaN if not known.
        stall_voltage: that voltage, in V, of models that measure no current; NaN for others.
        torque_constant: N·m for one A; NaN if not known or without current.
    """

    name: str
    number: int
    family: Family
    current_unit: float
    current_limit: int
    voltage: tuple[float, float]
    no_load_speed: float
    stall_torque: float
    torque_constant: float
    stall_voltage: float

    @property
    def takes_torque_by_pwm(self) -> bool:
        """Whether a torque can be made of voltages, where there is no current mode."""
        return OperatingMode.PWM in self.modes and not math.isnan(self.stall_voltage)

    @property
    def has_drive_mode(self) -> bool:
        """Whether it can count the other way."""
        return not self.family.is_older or self.name == "mx-106-1.0"

    @property
    def has_cable(self) -> bool:
        """Whether it has the synchronisation cable of two servos on one joint."""
        return "540" in self.name or "mx-106" in self.name

    @property
    def reports_current(self) -> bool:
        """Whether it measures current; otherwise it has a load in 0.1 % that is no physical effort."""
        return not math.isnan(self.current_unit)

    @property
    def errors(self) -> Mapping[int, str]:
        """What the bits of its hardware error mean."""
        if self.family.name == "XL-320":
            return XL320_ERRORS
        return PROTOCOL_1_ERRORS if self.family.protocol == 1 else HARDWARE_ERRORS

    @property
    def modes(self) -> frozenset[OperatingMode]:
        """Operating modes that it has."""
        return self.family.modes if self.reports_current else self.family.modes - _NEEDS_CURRENT

    def has_fast_read(self, firmware: int) -> bool:
        """Whether fast sync and fast bulk read work with this firmware."""
        since = self.family.fast_read_since
        return since is not None and firmware >= since


_5 = (3.1, 7.0)
_8 = (5.5, 14.0)
_11 = (6.0, 14.0)
_12 = (9.5, 16.0)
_15 = (12.0, 24.0)
_24 = (11.0, 30.0)
_P = (15.0, 40.0)
_LOAD = _NONE = math.nan

# name, number, family, A for one count, current limit, V, rev/min without load, stall N·m, stall A
_ROWS: Final = (
    ("xl330-m077", 1190, X330, 0.001, 1750, _5, 383.0, 0.215, 1.47),
    ("xl330-m288", 1200, X330, 0.001, 1750, _5, 103.0, 0.52, 1.47),
    ("xc330-t181", 1210, X330, 0.001, 910, _8, 104.0, 0.76, 0.80),
    ("xc330-t288", 1220, X330, 0.001, 910, _8, 65.0, 0.92, 0.80),
    ("xc330-m181", 1230, X330, 0.001, 2352, _5, 129.0, 0.60, 1.80),
    ("xc330-m288", 1240, X330, 0.001, 2352, _5, 81.0, 0.93, 1.80),
    ("xl430-w250", 1060, X, _LOAD, 0, _11, 57.0, 1.4, 1.3),
    ("xc430-w150", 1070, X, _LOAD, 0, _11, 106.0, 1.6, 1.4),
    ("xc430-w240", 1080, X, _LOAD, 0, _11, 70.0, 1.9, 1.4),
    ("2xl430-w250", 1090, X2, _LOAD, 0, _11, 57.0, 1.4, 1.3),
    ("2xc430-w250", 1160, X2, _LOAD, 0, _11, 64.0, 1.8, 1.4),
    ("xm430-w350", 1020, X, 0.00269, 1193, _12, 46.0, 4.1, 2.3),
    ("xm430-w210", 1030, X, 0.00269, 1193, _12, 77.0, 3.0, 2.3),
    ("xm540-w270", 1120, X, 0.00269, 2047, _12, 30.0, 10.6, 4.4),
    ("xm540-w150", 1130, X, 0.00269, 2047, _12, 53.0, 7.3, 4.4),
    ("xh430-w350", 1000, X, 0.00269, 0, _12, 30.0, 3.4, 1.3),
    ("xh430-w210", 1010, X, 0.00269, 0, _12, 50.0, 2.5, 1.3),
    ("xh430-v350", 1040, X, 0.00134, 689, _24, 31.0, 3.3, 0.7),
    ("xh430-v210", 1050, X, 0.00134, 689, _24, 52.0, 2.6, 0.7),
    ("xh540-w270", 1100, X, 0.00269, 2047, _12, 39.0, 9.9, 4.9),
    ("xh540-w150", 1110, X, 0.00269, 2047, _12, 70.0, 7.1, 4.9),
    ("xh540-v270", 1140, X, 0.00269, 2047, _24, 34.0, 9.2, 2.4),
    ("xh540-v150", 1150, X, 0.00269, 2047, _24, 60.0, 6.4, 2.4),
    ("xd430-t350", 1001, X, 0.00269, 0, _12, _NONE, _NONE, _NONE),
    ("xd430-t210", 1011, X, 0.00269, 0, _12, _NONE, _NONE, _NONE),
    ("xd540-t270", 1101, X, 0.00269, 0, _12, _NONE, _NONE, _NONE),
    ("xd540-t150", 1111, X, 0.00269, 0, _12, _NONE, _NONE, _NONE),
    ("xw540-t260", 1170, X, 0.00269, 0, _12, 40.0, 9.5, 4.9),
    ("xw540-t140", 1180, X, 0.00269, 0, _12, 72.0, 6.9, 4.9),
    ("xw540-h260", 1310, X, 0.00269, 0, _24, _NONE, _NONE, _NONE),
    ("xw430-t333", 1270, X, 0.00269, 0, _12, _NONE, _NONE, _NONE),
    ("xw430-t200", 1280, X, 0.00269, 0, _12, _NONE, _NONE, _NONE),
    ("mx-28", 30, MX, _LOAD, 0, _12, 55.0, 2.5, 1.4),
    ("mx-64", 311, MX, 0.00336, 1941, _12, 63.0, 6.0, 4.1),
    ("mx-106", 321, MX, 0.00336, 2047, _12, 45.0, 8.4, 5.2),
    # Continuous instead of stall.
    ("ph42-020-s300", 2000, PH42, 0.001, 4500, _P, 32.7, 5.1, 1.5),
    ("ph54-100-s500", 2010, PH54, 0.001, 15900, _P, 33.3, 25.3, 5.5),
    ("ph54-200-s500", 2020, PH54, 0.001, 22740, _P, 33.1, 44.7, 9.3),
    ("pm42-010-s260", 2100, PM42, 0.001, 1461, _P, 28.0, 1.7, 0.6),
    ("pm54-040-s250", 2110, PM54, 0.001, 4470, _P, 28.4, 3.9, 1.9),
    ("pm54-060-s250", 2120, PM54, 0.001, 7980, _P, 33.1, 10.1, 3.0),
    ("xl-320", 350, XL320, _LOAD, 0, (6.0, 8.4), 114.0, 0.39, 1.1),
    ("ax-12a", 12, AX, _LOAD, 0, _11, 59.0, 1.5, 1.5),
    ("ax-12w", 300, AX, _LOAD, 0, _11, 54.0, 0.2, 1.4),  # in joint mode; 470 as a wheel
    ("ax-18a", 18, AX, _LOAD, 0, _11, 97.0, 1.8, 2.2),
    ("rx-10", 10, AX, _LOAD, 0, _11, 54.0, 1.3, _NONE),
    ("rx-24f", 24, AX, _LOAD, 0, _11, 126.0, 2.6, 2.4),
    ("rx-28", 28, AX, _LOAD, 0, _15, 85.0, 3.7, 1.9),
    ("rx-64", 64, AX, _LOAD, 0, _15, 64.0, 5.3, 2.6),
    ("mx-12w-1.0", 360, MX_12, _LOAD, 0, _12, 470.0, 0.2, 1.4),
    ("mx-28-1.0", 29, MX_1, _LOAD, 0, _12, 55.0, 2.5, 1.4),
    ("mx-64-1.0", 310, MX_1, 0.0045, 0, _12, 63.0, 6.0, 4.1),
    ("mx-106-1.0", 320, MX_1, 0.0045, 0, _12, 45.0, 8.4, 5.2),
)

_TORQUE_CONSTANTS: Final = {"xc330-t181": 0.670947, "xc330-t288": 0.967480}
"""Given by ROBOTIS, instead of taken from the stall figures (dynamixel-sdk, unit info of these models)."""

_STALL_VOLTAGES: Final = {
    "xl430-w250": 11.1,
    "2xl430-w250": 11.1,
    "xc430-w150": 12.0,
    "xc430-w240": 12.0,
    "2xc430-w250": 12.0,
    "mx-28": 12.0,
}
"""Of several that the e-manual gives, that of the figures in the table (V)."""


def _model(
    name: str,
    number: int,
    family: Family,
    unit: float,
    limit: int,
    voltage: tuple[float, float],
    speed: float,
    torque: float,
    amperes: float,
) -> Model:
    constant = _TORQUE_CONSTANTS.get(name, torque / amperes)
    if math.isnan(unit):
        constant = math.nan
    stall_voltage = _STALL_VOLTAGES.get(name, math.nan)
    return Model(
        name, number, family, unit, limit, voltage, speed * RPM, torque, constant, stall_voltage
    )


MODELS: Final[Mapping[str, Model]] = MappingProxyType({row[0]: _model(*row) for row in _ROWS})
"""By name."""

_BY_NUMBER: Final = {model.number: model for model in MODELS.values()}


def model_named(name: str) -> Model:
    """Return a model by its name: ``xm430-w350``, ``XM430-W350-T`` and ``xm430_w350`` are the same.

    Raises:
        ConfigError: not known.
    """
    plain = name.strip().lower().replace("_", "-").replace(" ", "-")
    for candidate in (plain, plain.removesuffix("-t").removesuffix("-r")):
        if candidate in MODELS:
            return MODELS[candidate]
    meant = near_names(plain, MODELS, most=3)
    raise ConfigError(
        f"{name!r} is not a model that this driver knows",
        remedy=f"Like it are {', '.join(meant)}."
        if meant
        else "crtk-driver dynamixel scan tells the models on a bus.",
    )


def model_numbered(number: int, where: str = "") -> Model:
    """Return a model by the number that a ping tells.

    Raises:
        ConfigError: not known.
    """
    if number not in _BY_NUMBER:
        raise ConfigError(
            f"a servo says that its model number is {number}, which this driver does not know",
            where=where,
            remedy="If several servos have this id, their answers collide: connect them one at a time. "
            "Otherwise it needs a row in crtk_driver_dynamixel/models.py: please report it.",
        )
    return _BY_NUMBER[number]


HARDWARE_ERRORS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0: "input voltage out of range",
        1: "motor hall sensor",
        2: "overheating",
        3: "motor encoder",
        4: "electrical shock on the circuit, or not enough power for the motor",
        5: "overload",
    }
)
"""Bits of Hardware Error Status (70 in the X series) and of Shutdown (63)."""

XL320_ERRORS: Final[Mapping[int, str]] = MappingProxyType(
    {0: "overload", 1: "overheating", 2: "input voltage out of range"}
)
"""Bits of Hardware Error Status (50) of the XL-320."""

PROTOCOL_1_ERRORS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0: "input voltage out of range",
        1: "goal position outside of the angle limits",
        2: "overheating",
        3: "value out of range",
        4: "checksum of the instruction",
        5: "overload",
        6: "unknown instruction, or action without reg write",
    }
)
"""Bits of the error byte of every status packet of protocol 1.0."""


def hardware_error_text(status: int, bits: Mapping[int, str] = HARDWARE_ERRORS) -> str:
    """Return what a status of error bits says: ``overheating, overload``; empty if there is none."""
    numbers = [bit for bit in range(8) if status >> bit & 1]
    return ", ".join(bits.get(bit, f"unknown error (bit {bit})") for bit in numbers)
