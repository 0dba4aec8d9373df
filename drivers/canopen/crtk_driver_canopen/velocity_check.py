"""Whether the velocity that a drive reports is that of its positions: seen in the first moves. No I/O.

Nothing else shows a drive that reports its velocity (606Ch) in another unit than it takes it (60FFh).
"""

from __future__ import annotations

import math
from typing import Final

TOLERANCE: Final = 0.2
"""Part by which velocities and positions may disagree."""

_ENOUGH: Final = 0.3
"""Seconds in motion, at least a tenth of the greatest velocity, after which it is judged."""
_SAMPLES: Final = 20
_PART: Final = 0.1
"""Seconds of a part of the motion: one sample alone is a count or none, where positions are coarse."""
_STALE: Final = 15.0
"""How many times the age of a velocity all of it is at least, and a part a fifth of that."""
_SLOW: Final = 0.1
_COARSE: Final = 5.0
"""Units of velocity below which rounding is too much of it; half of the greatest velocity at most."""
_GAP: Final = 3.0
"""Periods between two samples that belong to one motion."""


class VelocityCheck:
    """Of one joint.

    Args:
        velocity: its limit, in rad/s (m/s).
        step: one unit of its measured velocity, in rad/s (m/s).
        period: of the cycle, in s.
        count: one unit of its position, in rad (m).
        every: cycles from one measured velocity to the next.

    Attributes:
        judged: whether it has moved enough.
        ratio: what the drive reports, for what its positions show; NaN until it is judged.
    """

    def __init__(
        self, velocity: float, step: float, period: float, count: float = 0.0, every: int = 1
    ) -> None:
        self._least = max(_SLOW * velocity, min(_COARSE * step, 0.5 * velocity))
        self._longest = _GAP * period
        self._step, self._count = step, count
        self._enough = max(_ENOUGH, _STALE * every * period)
        self._part = max(_PART, 0.2 * _STALE * every * period)
        self.judged = False
        self.ratio = math.nan
        self._last: tuple[float, float, float] | None = None
        self._seconds = self._way = self._told = self._rounded = 0.0
        self._samples = 0
        self._begin(0.0)

    def _begin(self, position: float) -> None:
        """Begin a part of the motion."""
        self._from, self._passed, self._integral, self._taken = position, 0.0, 0.0, 0

    @property
    def agrees(self) -> bool:
        """Whether there is nothing to be said: they differ by no more than tolerance and rounding."""
        return not self.judged or abs(self._told - self._way) <= (
            TOLERANCE * self._way + self._rounded
        )

    def forget(self) -> None:
        """What comes next does not follow from what was: a sample is missing, or positions are set."""
        self._last = None

    def take(self, position: float, velocity: float, time: float) -> bool:
        """Take a sample in rad (m) and rad/s (m/s); return whether it was judged by this one.

        Args:
            position: of the joint.
            velocity: that the drive reports.
            time: of the sample, in s.
        """
        last, self._last = self._last, (position, velocity, time)
        if self.judged:
            return False
        if last is None or not 0.0 < time - last[2] <= self._longest:
            self._begin(position)
            return False
        passed = time - last[2]
        self._passed += passed
        self._integral += 0.5 * (velocity + last[1]) * passed
        self._taken += 1
        if self._passed < self._part:
            return False
        moved, seconds, told = position - self._from, self._passed, self._integral
        if abs(moved) >= self._least * seconds:
            self._seconds += seconds
            self._way += abs(moved)
            self._told += math.copysign(told, told * moved)
            self._rounded += self._step * seconds + self._count
            self._samples += self._taken
        self._begin(position)
        if self._seconds >= self._enough and self._samples >= _SAMPLES:
            self.judged, self.ratio = True, self._told / self._way
        return self.judged

    def text(self) -> str:
        """Return what is wrong, in words."""
        return (
            f"its measured velocity (606Ch) is {self.ratio:.3g} times what its positions (6064h) show: one "
            "of them has another unit; give `measured_velocity_scale` (or `velocity_scale`, where commanded "
            "velocities are off as well), or correct the gear"
        )
