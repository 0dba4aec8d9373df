"""Between the motor and the units of an axis: 608F, 6091, 6092, 6096 and 607E (CiA 402-2, 9.3)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

SCALING: Final = (0x607E, 0x608F, 0x6091, 0x6092, 0x6096)

_REVERSED: Final = 0x80  # bit of the polarity 607E: positions are multiplied by -1


class Units:
    """Scale of an axis, computed anew by `update` when one of the objects has changed.

    Attributes:
        per_revolution: position units in one revolution of the motor, negative when reversed.
        increments: of the encoder in one revolution of the motor.
        velocity: velocity units for one position unit a second.
    """

    def __init__(self, value: Callable[[int, int], int]) -> None:
        self._value = value
        self.per_revolution = 1.0
        self.increments = 1.0
        self.velocity = 1.0
        self.update()

    def update(self) -> None:
        """Read the objects."""
        self.increments = self._ratio(0x608F)
        sign = -1 if self._value(0x607E, 0) & _REVERSED else 1
        self.per_revolution = sign * self._ratio(0x6092) / self._ratio(0x6091)
        self.velocity = self._ratio(0x6096)

    def _ratio(self, index: int) -> float:
        return self._value(index, 1) / self._value(index, 2)

    @property
    def per_radian(self) -> float:
        """Position units in one radian of the motor."""
        return self.per_revolution / (2 * math.pi)
