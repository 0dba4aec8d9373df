"""The models that can be simulated: their ratings, limits and units.

Sources: the e-manual's pages of each model (specifications and control table). Torque and speed are
those of the recommended voltage.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Final

from crtk_sim_backends.dynamixel.registers import LEGACY, OLDER, Series, Table, make_table

TURN: Final = 2.0 * math.pi
RPM: Final = TURN / 60.0


@dataclass(frozen=True, slots=True)
class Units:
    """What one count is, in SI: position rad, velocity rad/s, acceleration rad/s²."""

    counts: int  # of one turn
    zero: int
    position: float
    velocity: float
    acceleration: float
    full_pwm: int
    full_load: int


_X: Final = Units(4096, 2048, TURN / 4096, 0.229 * RPM, 214.577 * TURN / 3600.0, 885, 1000)
_AX: Final = Units(1024, 512, math.radians(300.0) / 1023, 0.111 * RPM, math.nan, 1023, 1023)
_MX12: Final = Units(4096, 2048, TURN / 4096, 0.916 * RPM, math.radians(8.583), 1023, 1023)
_MX1: Final = Units(4096, 2048, TURN / 4096, 0.114 * RPM, math.radians(8.583), 1023, 1023)


def _p(counts: int) -> Units:
    return Units(counts, 0, TURN / counts, 0.01 * RPM, TURN / 3600.0, 2009, 1000)


@dataclass(frozen=True, slots=True)
class Model:
    """One model.

    Attributes:
        current_unit: A; None: it reports a load in 0.1 % instead.
        torque: at stall, N·m.
        speed: without load, rad/s.
        amperes: at stall.
        supply: recommended voltage, V; least and greatest by its registers in 0.1 V.
    """

    name: str
    number: int
    series: Series
    units: Units
    current_unit: float | None
    current_limit: int
    velocity_limit: int
    torque: float
    speed: float
    amperes: float
    supply: float
    voltage_limits: tuple[int, int]

    @property
    def protocol(self) -> int:
        """That it speaks from the factory on."""
        return 1 if self.series in LEGACY else 2

    @property
    def newest_firmware(self) -> int:
        """The version that is simulated when none is asked for."""
        return _FIRMWARE[self.series]

    def table(self, firmware: int) -> Table:
        """Control table for a version of the firmware."""
        return _table(self.name, firmware)


@cache
def _table(name: str, firmware: int) -> Table:
    model = MODELS[name]
    return make_table(
        model.series,
        firmware,
        has_current=model.current_unit is not None,
        values=_values(model, firmware),
    )


def _values(model: Model, firmware: int) -> dict[str, tuple[int, int, int]]:
    """Factory value, low and high of the registers that differ from model to model."""
    low, high = model.voltage_limits
    amperes = model.current_limit
    values = {
        "model_number": (model.number, 0, 65535),
        "firmware_version": (firmware, 0, 255),
    }
    if model.series in OLDER:
        return values | {
            "max_voltage_limit": (high, 50, 250),
            "min_voltage_limit": (low, 50, 250),
            "goal_position": (model.units.zero, *_legacy_goals(model)),
        }
    values |= {
        "max_voltage_limit": (high, low, high),
        "min_voltage_limit": (low, low, high),
        "current_limit": (amperes, 0, amperes),
        "goal_current": (amperes, -amperes, amperes),
        "velocity_limit": (model.velocity_limit, 0, max(1023, model.velocity_limit)),
        "goal_position": (model.units.zero, -(2**31), 2**31 - 1),
        "pwm_limit": (model.units.full_pwm, 0, model.units.full_pwm),
        "goal_pwm": (model.units.full_pwm, -model.units.full_pwm, model.units.full_pwm),
    }
    if model.series is Series.X330:
        values["protocol_type"] = (2, 2, 22)
        values["shutdown"] = (0x35, 0, 63)
        values["baud_rate"] = (1, 0, 6)
        values["temperature_limit"] = (70, 0, 100)
    if model.series is Series.P:
        half = model.units.counts // 2
        values["max_position_limit"] = (half, -half, half)
        values["min_position_limit"] = (-half, -half, half)
        values["homing_offset"] = (0, -(2**31), 2**31 - 1)
        values["shutdown"] = (0x3A, 0, 63)
        values["profile_velocity"] = (0, 0, 2**31 - 1)
        values["profile_acceleration"] = (0, 0, 2**31 - 1)
        values["acceleration_limit"] = (10765, 0, 2**31 - 1)
    if firmware < 42:
        values["drive_mode"] = (0, 0, 3)
    return values


def _legacy_goals(model: Model) -> tuple[int, int]:
    return (-28672, 28672) if model.series is Series.MX_LEGACY else (0, 1023)


_FIRMWARE: Final = {
    Series.X: 52,
    Series.X540: 52,
    Series.X330: 52,
    Series.X2: 47,
    Series.MX: 45,
    Series.P: 14,
    Series.AX: 24,
    Series.MX_LEGACY: 36,
    Series.XL320: 29,
}

_5V = (5.0, (31, 70))
_11V = (11.1, (60, 140))
_12V_X = (12.0, (60, 140))
_12V = (12.0, (95, 160))
_24V = (24.0, (110, 300))
_P24 = (24.0, (150, 400))

# name, number, series, units, A, current limit, velocity limit, stall N·m, rev/min, stall A, supply
_ROWS: Final = (
    ("xl330-m077", 1190, Series.X330, _X, 0.001, 1750, 1620, 0.215, 383.0, 1.47, _5V),
    ("xl330-m288", 1200, Series.X330, _X, 0.001, 1750, 445, 0.52, 103.0, 1.47, _5V),
    ("xc330-t181", 1210, Series.X330, _X, 0.001, 910, 496, 0.76, 104.0, 0.80, (12.0, (55, 140))),
    ("xc330-t288", 1220, Series.X330, _X, 0.001, 910, 320, 0.92, 65.0, 0.80, (12.0, (55, 140))),
    ("xc330-m181", 1230, Series.X330, _X, 0.001, 2352, 620, 0.60, 129.0, 1.80, _5V),
    ("xc330-m288", 1240, Series.X330, _X, 0.001, 2352, 390, 0.93, 81.0, 1.80, _5V),
    ("xl430-w250", 1060, Series.X, _X, None, 0, 265, 1.4, 57.0, 1.3, _11V),
    ("xc430-w150", 1070, Series.X, _X, None, 0, 460, 1.6, 106.0, 1.4, _12V_X),
    ("xc430-w240", 1080, Series.X, _X, None, 0, 306, 1.9, 70.0, 1.4, _12V_X),
    ("2xl430-w250", 1090, Series.X2, _X, None, 0, 265, 1.4, 57.0, 1.3, _11V),
    ("2xc430-w250", 1160, Series.X2, _X, None, 0, 277, 1.8, 64.0, 1.4, _12V_X),
    ("xm430-w350", 1020, Series.X, _X, 0.00269, 1193, 200, 4.1, 46.0, 2.3, _12V),
    ("xm430-w210", 1030, Series.X, _X, 0.00269, 1193, 330, 3.0, 77.0, 2.3, _12V),
    ("xm540-w270", 1120, Series.X540, _X, 0.00269, 2047, 128, 10.6, 30.0, 4.4, _12V),
    ("xm540-w150", 1130, Series.X540, _X, 0.00269, 2047, 230, 7.3, 53.0, 4.4, _12V),
    ("xh430-w350", 1000, Series.X, _X, 0.00269, 648, 135, 3.4, 30.0, 1.3, _12V),
    ("xh430-w210", 1010, Series.X, _X, 0.00269, 648, 220, 2.5, 50.0, 1.3, _12V),
    ("xh430-v350", 1040, Series.X, _X, 0.00134, 689, 135, 3.3, 31.0, 0.7, _24V),
    ("xh430-v210", 1050, Series.X, _X, 0.00134, 689, 230, 2.6, 52.0, 0.7, _24V),
    ("xh540-w270", 1100, Series.X540, _X, 0.00269, 2047, 170, 9.9, 39.0, 4.9, _12V),
    ("xh540-w150", 1110, Series.X540, _X, 0.00269, 2047, 300, 7.1, 70.0, 4.9, _12V),
    ("xh540-v270", 1140, Series.X540, _X, 0.00269, 1188, 150, 9.2, 34.0, 2.4, _24V),
    ("xh540-v150", 1150, Series.X540, _X, 0.00269, 1188, 265, 6.4, 60.0, 2.4, _24V),
    ("mx-28", 30, Series.MX, _X, None, 0, 230, 2.5, 55.0, 1.4, _12V),
    ("mx-64", 311, Series.MX, _X, 0.00336, 1941, 435, 6.0, 63.0, 4.1, _12V),
    ("mx-106", 321, Series.MX, _X, 0.00336, 2047, 210, 8.4, 45.0, 5.2, _12V),
    ("ph42-020-s300", 2000, Series.P, _p(607_500), 0.001, 4500, 2920, 10.0, 32.7, 3.0, _P24),
    ("ph54-100-s500", 2010, Series.P, _p(1_003_846), 0.001, 15900, 2920, 50.0, 33.3, 11.0, _P24),
    ("ph54-200-s500", 2020, Series.P, _p(1_003_846), 0.001, 22740, 2900, 90.0, 33.1, 18.6, _P24),
    ("pm42-010-s260", 2100, Series.P, _p(526_374), 0.001, 1461, 2600, 3.4, 28.0, 1.2, _P24),
    ("pm54-040-s250", 2110, Series.P, _p(502_834), 0.001, 4470, 2840, 7.8, 28.4, 3.8, _P24),
    ("pm54-060-s250", 2120, Series.P, _p(502_834), 0.001, 7980, 2840, 20.0, 33.1, 6.0, _P24),
    ("ax-12a", 12, Series.AX, _AX, None, 0, 1023, 1.5, 59.0, 1.5, (12.0, (60, 140))),
    ("xl-320", 350, Series.XL320, _AX, None, 0, 1023, 0.39, 114.0, 1.1, (7.4, (60, 90))),
    ("ax-12w", 300, Series.AX, _AX, None, 0, 1023, 0.2, 470.0, 1.4, (12.0, (60, 140))),
    ("ax-18a", 18, Series.AX, _AX, None, 0, 1023, 1.8, 97.0, 2.2, (12.0, (60, 140))),
    ("rx-28", 28, Series.AX, _AX, None, 0, 1023, 3.7, 85.0, 1.9, (14.8, (60, 240))),
    ("rx-64", 64, Series.AX, _AX, None, 0, 1023, 5.3, 64.0, 2.6, (14.8, (60, 240))),
    ("mx-12w-1.0", 360, Series.MX_LEGACY, _MX12, None, 0, 1023, 0.2, 470.0, 1.4, (12.0, (60, 160))),
    ("mx-28-1.0", 29, Series.MX_LEGACY, _MX1, None, 0, 1023, 2.5, 55.0, 1.4, (12.0, (60, 160))),
    ("mx-64-1.0", 310, Series.MX_LEGACY, _MX1, 0.0045, 0, 1023, 6.0, 63.0, 4.1, (12.0, (60, 160))),
    ("mx-106-1.0", 320, Series.MX_LEGACY, _MX1, 0.0045, 0, 1023, 8.4, 45.0, 5.2, (12.0, (60, 160))),
)

MODELS: Final[Mapping[str, Model]] = MappingProxyType(
    {
        name: Model(name, number, series, units, unit, i, v, nm, rpm * RPM, a, supply[0], supply[1])
        for name, number, series, units, unit, i, v, nm, rpm, a, supply in _ROWS
    }
)
"""Every model, by name."""
