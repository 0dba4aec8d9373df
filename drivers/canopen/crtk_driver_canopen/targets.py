"""The positions that an axis is really sent: none runs ahead of one that is not heard. No I/O."""

from __future__ import annotations

import math
from typing import Final

UNHEARD: Final = 1
"""Cycles in a row without the position of an axis that do not matter: a frame may be lost, or come late."""


class PositionTarget:
    """The target position of one axis, in its counts; stepped once a cycle.

    An axis that is not heard may not hear us either, and stands while the setpoints go on: the first one that
    reaches it would be a jump. Its target therefore stays where it was; when the axis is heard again, the
    target goes from there to the setpoint within the limits of the joint.

    Args:
        velocity: greatest one, in counts a cycle.
        acceleration: greatest one, in counts a cycle².

    Attributes:
        sent: the last target.
        behind: whether that is not the setpoint.
    """

    def __init__(self, velocity: float, acceleration: float) -> None:
        self.sent = 0
        self.behind = False
        self._velocity = max(1.0, velocity)
        self._change = max(1.0, acceleration)  # counts are whole: less would never be met
        self._at = 0.0
        self._speed = 0.0
        self._wanted = 0

    def set(self, wanted: int) -> int:
        """Return the target of an axis that follows no positions: whatever is wanted."""
        self.behind = False
        self.sent = self._wanted = wanted
        return wanted

    def step(self, wanted: int, *, heard: bool) -> int:
        """Return the target of an axis that follows positions.

        Args:
            wanted: the setpoint.
            heard: whether it has told where it is.
        """
        before, self._wanted = self._wanted, wanted
        if not heard:
            self.behind, self._at, self._speed = True, float(self.sent), 0.0
        elif self.behind:
            self._pursue(wanted, wanted - before)
            self.sent = round(self._at)
        else:
            self.sent = wanted
        return self.sent

    def _pursue(self, wanted: int, pace: float) -> None:
        """Go on towards a setpoint that moves at `pace`, in counts a cycle."""
        limit, change = self._velocity, self._change
        left = wanted - self._at
        if abs(left) <= limit and abs(left - self._speed) <= change and abs(left - pace) <= change:
            self.behind, self._at = False, float(wanted)
            return
        off = left - pace
        # The speed that slows down to that of the setpoint just where it is, in whole cycles.
        closing = 0.5 * change * (math.sqrt(1.0 + 8.0 * abs(off) / change) - 1.0)
        aim = min(max(pace + math.copysign(closing, off), -limit), limit)
        self._speed = min(max(aim, self._speed - change), self._speed + change)
        self._at += self._speed
