"""Between the motor and the units of an axis: 607E, 608F, 6091, 6092, 6096 and 60A8 to 60AA (CiA 402-2, 9.3).

A make may count otherwise than CiA 402 says: then its habits say what, and no object tells it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

SCALING: Final = (0x607E, 0x608F, 0x6091, 0x6092, 0x6096, 0x60A8, 0x60A9, 0x60AA)

_REVOLUTIONS: Final = 0xB4  # numerators of a unit (CiA 303-2)
_REVOLUTIONS_A_MINUTE: Final = 0xC0  # of the vendor's, in 60AA
_OF_A_TURN: Final = {
    0x10: math.tau,
    0x40: 400.0,
    0x41: 360.0,
    0x42: 360.0 * 60.0,
    0x43: 360.0 * 3600.0,
    _REVOLUTIONS: 1.0,
}  # radian, gradian, degree, its minute and second
_SECONDS: Final = {0x03: 1.0, 0x47: 60.0, 0x48: 3600.0}  # by denominator
_SECONDS_SQUARED: Final = 0x57

_LEAST: Final = 1e-20  # of a scale; its inverse is the greatest one

_REVERSED: Final = 0x80  # bit of the polarity 607E: positions are multiplied by -1


@dataclass(frozen=True)
class Counting:
    """Units of a rate: how many for one position unit, or one turn of the motor, a second (squared)."""

    units: float
    of_turns: bool = False

    def of(self, per_revolution: float) -> float:
        """How many units for one position unit a second (squared)."""
        return self.units / per_revolution if self.of_turns else self.units


@dataclass(frozen=True)
class Habits:
    """In what a make counts where no object tells it; None: as CiA 402 says.

    Attributes:
        velocity: of 60FF, 607F, 6081, 6099.
        shown: of 606C, 606B and 6069; None: as `velocity`.
        acceleration: of all accelerations.
        ramp_time: s for one unit of 6083, 6084 and 609A, which are the times of ramps.
    """

    velocity: Counting | None = None
    shown: Counting | None = None
    acceleration: Counting | None = None
    ramp_time: float | None = None


CIA: Final = Habits()


class Units:
    """Scale of an axis, computed anew by `update` when one of the objects has changed.

    Attributes:
        per_revolution: position units in one revolution of the motor, negative when reversed.
        increments: of the encoder in one revolution of the motor.
        velocity: velocity units for one position unit a second.
        shown: the same of velocities that the axis shows.
        acceleration: acceleration units for one position unit a second squared.
        ramp_time: s for one unit of 6083, 6084 and 609A where these are times; None: they are accelerations.

    Args:
        value: reads an object of the axis.
        has_feed: whether there is a feed constant (6092); without, positions are increments.
        habits: of its make.
        tells_acceleration: whether it has 60AA; without, accelerations are velocity units a second.
    """

    def __init__(
        self,
        value: Callable[[int, int], int],
        has_feed: bool = True,
        habits: Habits = CIA,
        tells_acceleration: bool = True,
    ) -> None:
        self._value = value
        self._has_feed = has_feed
        self._habits = habits
        self._tells_acceleration = tells_acceleration
        self.per_revolution = 1.0
        self.increments = 1.0
        self.velocity = 1.0
        self.shown = 1.0
        self.acceleration = 1.0
        self.ramp_time = habits.ramp_time
        self.update()

    def update(self) -> None:
        """Read the objects."""
        habits = self._habits
        self.increments = self._ratio(0x608F)
        sign = -1 if self._value(0x607E, 0) & _REVERSED else 1
        units = self._ratio(0x6092) / self._ratio(0x6091) if self._has_feed else self.increments
        angle = _angle_units(self._value(0x60A8, 0))
        if angle is not None:
            units = angle / self._ratio(0x6091)
        self.per_revolution = sign * units
        told = turns_factor(self._value(0x60A9, 0), units) or 1.0
        velocity = told if habits.velocity is None else habits.velocity.of(units)
        self.velocity = velocity * self._ratio(0x6096)
        self.shown = self.velocity if habits.shown is None else habits.shown.of(units)
        self.acceleration = self._acceleration(velocity, units)

    def _acceleration(self, velocity: float, units: float) -> float:
        if self._habits.acceleration is not None:
            return self._habits.acceleration.of(units)
        if not self._tells_acceleration:
            return velocity
        return acceleration_factor(self._value(0x60AA, 0), units) or 1.0

    @property
    def sane(self) -> bool:
        """Whether positions and rates can be told by these units: none is 0, or beyond all numbers."""
        scales = (
            self.per_revolution,
            self.increments,
            self.velocity,
            self.shown,
            self.acceleration,
        )
        return all(_LEAST < abs(scale) < 1.0 / _LEAST for scale in scales)

    def _ratio(self, index: int) -> float:
        return self._value(index, 1) / self._value(index, 2)

    @property
    def per_radian(self) -> float:
        """Position units in one radian of the motor."""
        return self.per_revolution / (2 * math.pi)


def _parts(unit: int) -> tuple[float, int, int]:
    """Power of ten, numerator and denominator of a unit object (CiA 402-2, 9.3)."""
    prefix, numerator, denominator = (unit >> shift & 0xFF for shift in (24, 16, 8))
    return 10.0 ** (prefix - 256 if prefix > 127 else prefix), numerator, denominator


def _angle_units(unit: int) -> float | None:
    """Position units in a turn of the shaft where 60A8 says an angle; None where it does not."""
    power, numerator, _ = _parts(unit)
    return _OF_A_TURN[numerator] / power if numerator in _OF_A_TURN else None


def turns_factor(unit: int, per_revolution: float) -> float | None:
    """Velocity units for one position unit a second, where 60A9 counts angles of the motor; None if not.

    Args:
        unit: 60A9: prefix, numerator and denominator (CiA 402-2, 9.3).
        per_revolution: position units in one turn of the motor.
    """
    power, numerator, denominator = _parts(unit)
    if numerator not in _OF_A_TURN or denominator not in _SECONDS:
        return None
    return _OF_A_TURN[numerator] * _SECONDS[denominator] / per_revolution / power


def acceleration_factor(unit: int, per_revolution: float) -> float | None:
    """Acceleration units for one position unit a second squared, by 60AA; None where it counts these.

    Args:
        unit: 60AA; a turn a minute (C0) is of its own.
        per_revolution: position units in one turn of the motor.
    """
    power, numerator, denominator = _parts(unit)
    if numerator == _REVOLUTIONS_A_MINUTE and denominator in _SECONDS:
        return 60.0 * _SECONDS[denominator] / per_revolution / power
    if numerator not in _OF_A_TURN:
        return None
    if denominator == _SECONDS_SQUARED:
        time = 1.0
    elif denominator in _SECONDS:
        time = _SECONDS[denominator] ** 2
    else:
        return None
    return _OF_A_TURN[numerator] * time / per_revolution / power
