"""Between the motor and the units of an axis: 608F, 6091, 6092, 6096 and 607E (CiA 402-2, 9.3)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

SCALING: Final = (0x607E, 0x608F, 0x6091, 0x6092, 0x6096, 0x60A9)

_REVOLUTIONS: Final = 0xB4  # numerator of a unit (CiA 303-2)
_SECONDS: Final = {0x03: 1.0, 0x47: 60.0, 0x48: 3600.0}  # by denominator

_REVERSED: Final = 0x80  # bit of the polarity 607E: positions are multiplied by -1


class Units:
    """Scale of an axis, computed anew by `update` when one of the objects has changed.

    Attributes:
        per_revolution: position units in one revolution of the motor, negative when reversed.
        increments: of the encoder in one revolution of the motor.
        velocity: velocity units for one position unit a second.
        acceleration: acceleration units for one position unit a second squared.

    Args:
        value: reads an object of the axis.
        has_feed: whether there is a feed constant (6092); without, positions are increments.
    """

    def __init__(self, value: Callable[[int, int], int], has_feed: bool = True) -> None:
        self._value = value
        self._has_feed = has_feed
        self.per_revolution = 1.0
        self.increments = 1.0
        self.velocity = 1.0
        self.acceleration = 1.0
        self.update()

    def update(self) -> None:
        """Read the objects."""
        self.increments = self._ratio(0x608F)
        sign = -1 if self._value(0x607E, 0) & _REVERSED else 1
        units = self._ratio(0x6092) / self._ratio(0x6091) if self._has_feed else self.increments
        self.per_revolution = sign * units
        self.acceleration = turns_factor(self._value(0x60A9, 0), units) or 1.0
        self.velocity = self.acceleration * self._ratio(0x6096)

    def _ratio(self, index: int) -> float:
        return self._value(index, 1) / self._value(index, 2)

    @property
    def per_radian(self) -> float:
        """Position units in one radian of the motor."""
        return self.per_revolution / (2 * math.pi)


def turns_factor(unit: int, per_revolution: float) -> float | None:
    """Velocity units for one position unit a second, where 60A9 counts turns of the motor; None if not.

    Args:
        unit: 60A9: prefix, numerator and denominator (CiA 402-2, 9.3).
        per_revolution: position units in one turn of the motor.
    """
    prefix, numerator, denominator = (unit >> shift & 0xFF for shift in (24, 16, 8))
    if numerator != _REVOLUTIONS or denominator not in _SECONDS:
        return None
    power = prefix - 256 if prefix > 127 else prefix
    return _SECONDS[denominator] / per_revolution / 10.0**power
