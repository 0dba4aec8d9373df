"""The parameters of one drive, read and written as on its line. No wire and no clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from crtk_sim_backends.copley.axis import FOLLOWING, Axis, Point
from crtk_sim_backends.copley.config import SimConfig

OK: Final = "ok"
_MOST: Final = 2**31
_FIRST_WITH_PVT: Final = 0x0100
_CANNOT_BE_CLEARED: Final = 1 << 0 | 1 << 1 | 1 << 11

_SCALED: Final = {
    0xCB: ("speed", 0.1),
    0xCC: ("acceleration", 10.0),
    0xCD: ("deceleration", 10.0),
    0xCF: ("abort_deceleration", 10.0),
    0xBA: ("following_limit", 1.0),
    0xC2: ("home_method", 1.0),
    0xC3: ("home_fast", 0.1),
    0xC4: ("home_slow", 0.1),
    0xC5: ("home_acceleration", 10.0),
    0xC8: ("profile", 1.0),
    0xCA: ("goal", 1.0),
}
"""Parameters that are a number of the axis, and their unit."""

_STATES: Final = (0, 1, 11, 21)


class Refused(Exception):
    """A command is not taken; the argument is its error code."""


class Drive:
    """One drive with an axis.

    Args:
        config: its options.
        place: where its motor is, in counts.
    """

    def __init__(self, config: SimConfig, place: float) -> None:
        self._config = config
        self.axis = Axis(config.travel, config.home_at, config.index_every, place)
        self.axis.places, self.axis.fastest = config.pvt_places, float(config.motor_speed)
        self.state = 0
        self.home_offset = 0
        self.was_reset = True
        self.input_off = False
        self.extra = 0
        """Bits of the event status that a fault sets."""

    # Registers

    @property
    def status(self) -> int:
        """Event status (0xa0)."""
        axis = self.axis
        bits = {
            9: axis.positive_limit,
            10: axis.negative_limit,
            11: self.input_off,
            12: self.state == 0,
            13: axis.mode == "stop",
            15: not axis.on,
            18: bool(axis.latched & FOLLOWING),
            20: self.was_reset,
            22: axis.latched,
            26: axis.home_switch,
            27: axis.mode or abs(axis.velocity) > 200.0,
        }
        return self.extra | sum(1 << bit for bit, is_set in bits.items() if is_set)

    @property
    def trajectory(self) -> int:
        """Trajectory status (0xc9)."""
        axis = self.axis
        bits = {
            11: axis.home_error,
            12: axis.referenced,
            13: axis.homing,
            14: axis.aborted,
            15: axis.mode,
        }
        return sum(1 << bit for bit, is_set in bits.items() if is_set)

    def switch(self) -> None:
        """Give or take the motor's power, as state and inputs say."""
        wanted = self.state == 21 and not self.input_off and not self.axis.latched
        if wanted != self.axis.on:
            self.axis.power(on=wanted)

    # Commands

    def get(self, parameter: int) -> str:
        """Return the values of a parameter in RAM, as they are told.

        Raises:
            Refused: there is none.
        """
        axis = self.axis
        told: dict[int, Callable[[], int]] = {
            0x0C: lambda: round(100.0 * axis.current),
            0x17: lambda: axis.counts,
            0x18: lambda: round(10.0 * axis.velocity),
            0x24: lambda: self.state,
            0x2D: lambda: round(axis.reference),
            0x32: lambda: axis.counts,
            0x94: lambda: self._config.firmware,
            0xA0: lambda: self.status,
            0xA4: lambda: axis.latched,
            0xC6: lambda: self.home_offset,
            0xC9: lambda: self.trajectory,
        }
        if parameter == 0x115 and self._config.firmware >= _FIRST_WITH_PVT:
            return f"{axis.places - len(axis.points)} {len(axis.told) & 0xFFFF}"
        if parameter in _SCALED:
            name, unit = _SCALED[parameter]
            return f"{round(getattr(axis, name) / unit)}"
        if parameter not in told:
            raise Refused(9)
        value = told[parameter]()
        return f"{value - 2**32 if value >= _MOST else value}"

    def put(self, parameter: int, values: list[int]) -> None:
        """Set a parameter in RAM.

        Raises:
            Refused: there is none, or it does not take that.
        """
        if parameter == 0x115 and self._config.firmware >= _FIRST_WITH_PVT:
            self._put_point(values)
            return
        if len(values) != 1:
            raise Refused(5 if values else 4)
        value = values[0]
        if not -_MOST <= value < _MOST:
            raise Refused(10)
        if parameter in _SCALED:
            name, unit = _SCALED[parameter]
            setattr(self.axis, name, int(value) if unit == 1.0 else value * unit)
        elif parameter == 0x24:
            if value not in _STATES:
                raise Refused(10)
            self.state = value
            self.was_reset = False
            self.switch()
        elif parameter == 0xA4:
            self.axis.latched &= ~value | _CANNOT_BE_CLEARED
            self.switch()
        elif parameter == 0xC6:
            self.home_offset = value
        elif parameter in (0x0C, 0x17, 0x18, 0x2D, 0x32, 0x94, 0xA0, 0xC9):
            raise Refused(11)
        else:
            raise Refused(9)

    def _put_point(self, values: list[int]) -> None:
        if values == [0x8000]:
            self.axis.clear()
            return
        if len(values) != 3:
            raise Refused(4 if len(values) < 3 else 5)
        time, position, velocity = values
        if not 0 <= time <= 255:
            raise Refused(10)
        if not self.axis.add(Point(time / 1000.0, float(position), velocity / 10.0)):
            raise Refused(1)

    def trajectory_command(self, code: int) -> None:
        """Carry out ``t``: bits 12 to 15 are axes, of which there is one.

        Raises:
            Refused: why it does not.
        """
        what = code & 0xFFF
        if what == 0:
            self.axis.abort()
        elif not self.axis.on:
            raise Refused(18)
        elif what in (1, 4):
            if error := self.axis.update():
                raise Refused(error)
        elif what == 2:
            if error := self.axis.home():
                raise Refused(error)
        else:
            raise Refused(10)
