"""Poses that stood: means of what did not move for a while, one for each new place. No clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crtk_drivers.geometry.rates import turn
from crtk_drivers.labs.calibration.stacks import mean_pose
from crtk_drivers.samples import Pose

LEAST: int = 5
"""Readings of which a mean is made."""


@dataclass(frozen=True, slots=True)
class Still:
    """What counts as standing, and what as another place.

    Attributes:
        seconds: for which it must stand.
        within: m that positions may differ meanwhile.
        turned: rad that orientations may.
        apart: m from the last place; either this or `apart_turned` makes another one.
        apart_turned: rad from the last place.
    """

    seconds: float = 0.5
    within: float = 1e-3
    turned: float = 5e-3
    apart: float = 0.02
    apart_turned: float = 0.15


def distance(first: Pose, second: Pose) -> tuple[float, float]:
    """Return how far two poses are apart: m, rad."""
    moved = float(np.linalg.norm(first.position - second.position))
    return moved, float(np.linalg.norm(turn(first.orientation, second.orientation)))


class StillPoses:
    """Takes readings of one or more bodies that are read together, and returns means where all stood."""

    def __init__(self, still: Still) -> None:
        self._still = still
        self._window: deque[tuple[float, tuple[Pose, ...]]] = deque()
        self._last: Pose | None = None

    def feed(self, now: float, poses: Sequence[Pose] | None) -> tuple[Pose, ...] | None:
        """Return the means of a place where they stood, once for each; None meanwhile.

        Args:
            now: monotonic seconds.
            poses: of each body; None where one is not seen. The first says which place it is.
        """
        if poses is None:
            self._window.clear()
            return None
        window, still = self._window, self._still
        window.append((now, tuple(poses)))
        began = now - still.seconds
        while len(window) > 1 and window[1][0] <= began:
            window.popleft()
        if window[0][0] > began or len(window) < LEAST:
            return None
        bodies = tuple(zip(*(each for _, each in window), strict=True))
        means = tuple(map(mean_pose, bodies))
        for mean, body in zip(means, bodies, strict=True):
            if any(self._exceeds(mean, pose, still.within, still.turned) for pose in body):
                return None
        last = self._last
        if last is not None and not self._exceeds(last, means[0], still.apart, still.apart_turned):
            return None
        self._last = means[0]
        return means

    @staticmethod
    def _exceeds(first: Pose, second: Pose, moved: float, turned: float) -> bool:
        far, angle = distance(first, second)
        return far > moved or angle > turned
