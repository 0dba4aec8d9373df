"""Whether joints move or stand, as the positions tell that their drives measure. No I/O."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_driver_canopen.config import CanopenConfig
from crtk_drivers.samples import Vector, vector

__all__ = ["STOOD", "Standing"]

STOOD: Final = 3
"""Samples without motion after which joints stand that were told to stop."""
STEP: Final = 4.0
"""Counts by which a joint has to get on while it moves by its drive's own, however slow that is."""
MOVED: Final = 0.1
"""Seconds after its last motion in which a joint counts as moving."""
STILL: Final = 0.01
"""Part of the greatest velocity of a joint below which it counts as standing."""


class Standing:
    """Of all n joints of an arm.

    Args:
        config: of the arm.

    Attributes:
        moving: whether a joint moved between the last two samples.
        samples: in a row in which none did.
        positions: (n,) the last ones, in rad (m).
        speed: (n,) between the last two samples, in rad/s (m/s).
        since: monotonic s since which all joints are where they are, but for a few counts.
    """

    def __init__(self, config: CanopenConfig) -> None:
        self._period = config.period
        self._velocities = np.array([joint.velocity for joint in config.joints.values()])
        self._last_moved = np.full(len(self._velocities), -np.inf)
        self.speed: NDArray[np.float64] = np.zeros(len(self._velocities))
        self.since = self._noted = 0.0
        self.begin([0.0] * len(self._velocities))

    def begin(self, units: Sequence[float]) -> None:
        """The drives have just been found.

        Args:
            units: rad (m) of one count of each.
        """
        # unless it stands and its last count flickers
        self._still = np.maximum(STILL * self._velocities * self._period, 1.5 * np.array(units))
        self._step = STEP * np.array(units)
        self.positions: Vector = vector(())
        self._stands_at: Vector = vector(())
        self.moving, self.samples = False, 0

    def note(self, positions: Vector, now: float) -> None:
        """Take where all joints are (n,)."""
        if positions.size == self.positions.size:
            moved = positions - self.positions
            moves = np.abs(moved) > self._still
            self._last_moved[moves] = now
            self.moving = bool(moves.any())
            passed = now - self._noted
            self.speed = moved / (passed if passed > 2.0 * self._period else self._period)
        self.samples = 0 if self.moving else self.samples + 1
        there = self._stands_at
        if there.size != positions.size or (np.abs(positions - there) > self._step).any():
            self._stands_at, self.since = positions, now
        self.positions, self._noted = positions, now

    def count_anew(self) -> None:
        """What was seen of standing does not count: something begins, or not all told where they are."""
        self.samples = 0

    def moved_lately(self, now: float) -> NDArray[np.bool_]:
        """Return which joints (n,) have moved just before a time, in monotonic seconds."""
        found: NDArray[np.bool_] = now - self._last_moved < MOVED
        return found
