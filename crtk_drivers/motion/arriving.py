"""Whether the joints come nearer to the end of a move, and stand there.

Hardware with a speed of its own is behind a trajectory of ours, and some says that it has ended a move before
it has. A joint that is within its `Following.arrival` may still be on its way.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from crtk_drivers.motion.context import MotionContext
from crtk_drivers.samples import Vector

NEARER: Final = 0.01
"""Share by which joints have come nearer: of what they all together were away from the end, or of the
smallest `Following.arrival` if that is more."""

RESTS: Final = 0.1
"""Seconds without coming nearer after which joints stand, be it that they tremble."""


class Arriving:
    """The joints of a device on the last part of a move.

    Args:
        context: of the device.
        goal: (n,) positions at its end.
    """

    def __init__(self, context: MotionContext, goal: Vector) -> None:
        self._measured = context.feedback.measured_state
        self._stopping = context.stopping
        following = context.capabilities.following
        self._is_watched = following is not None
        self._within = 0.0 if following is None else min(following.arrival, default=0.0)
        self._goal = goal
        self._nearest = math.inf
        self._nearer = 0.0

    def came_nearer(self, time: float) -> float:
        """Look at the joints; return when they came nearer last, in the seconds of `time`; 0 before.

        Args:
            time: seconds since the move should have ended.
        """
        here = self._measured()[0].position
        if here.size and here.size == self._goal.size:
            off = float(np.abs(here - self._goal).sum())
            # Less is no way to go: a position that is computed settles for ever.
            least = NEARER * max(off, self._within)
            if off < self._nearest - least:
                self._nearest, self._nearer = off, time
        return self._nearer

    def rests(self, time: float) -> bool:
        """Whether the joints stand; True where they are not watched. Asked after `came_nearer`."""
        if not self._is_watched or self._stopping.stands:
            return True
        return time - self._nearer >= RESTS
