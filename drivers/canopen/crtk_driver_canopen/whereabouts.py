"""Where an axis is, as far as it can be believed: no position that it cannot have come to. No I/O."""

from __future__ import annotations

import math
from typing import Final

HASTE: Final = 10.0
"""Times its greatest velocity with which a joint may move, pushed or falling, and be believed."""

_FLICKER: Final = 16
"""Counts that a position may change by in any time."""


class Whereabouts:
    """The position of one axis, in its counts; what it tells is taken once a cycle.

    Args:
        position: where it is.
        velocity: the greatest of its joint, in counts a second.
        period: of the cycle, in s: two positions are that far apart, however soon after each other they come.

    Attributes:
        position: the last one that could be believed.
        told: the last one that it told.
        strange: how many times in a row it has told one that it cannot have come to.
    """

    def __init__(self, position: int, velocity: float, period: float) -> None:
        self.position = self.told = position
        self.strange = 0
        self._fastest = HASTE * velocity
        self._period = period
        self._heard = -math.inf

    def forget(self) -> None:
        """It is set up anew, and may be anywhere: what it tells next is believed."""
        self._heard = -math.inf

    def take(self, told: int, now: float, *, may_be_set: bool) -> int:
        """Take what it tells, and return where it is.

        Args:
            told: its position (6064).
            now: monotonic seconds.
            may_be_set: it may be given another position now, by homing or a restart. Power makes no
                difference: a wrong position that is believed without it is the target when it comes.
        """
        most = self._fastest * max(now - self._heard, self._period) + _FLICKER
        self._heard, self.told = now, told
        if not may_be_set and abs(told - self.position) > most:
            self.strange += 1
        else:
            self.strange, self.position = 0, told
        return self.position
