"""How fast a grip turns: the service tells orientations alone. No I/O."""

from __future__ import annotations

from collections import deque
from typing import Final

from crtk_drivers.geometry.rates import turn
from crtk_drivers.samples import Vector, vector

__all__ = ["Turning"]

WINDOW: Final = 0.03
"""Seconds over which orientations are compared: a wireless grip has new ones less often than it tells."""
_NONE: Final = vector((0.0, 0.0, 0.0))


class Turning:
    """The mean angular velocity over the last `WINDOW`."""

    def __init__(self) -> None:
        self._past: deque[tuple[float, Vector]] = deque()

    def forget(self) -> None:
        """Begin anew: what came before is not of one motion with what comes."""
        self._past.clear()

    def take(self, orientation: Vector, now: float) -> Vector:
        """Return the angular velocity (3,) in rad/s, axes of the base; zero until it can be told.

        Args:
            orientation: x, y, z, w.
            now: monotonic seconds.
        """
        past = self._past
        past.append((now, orientation))
        while len(past) > 2 and past[1][0] <= now - WINDOW:
            past.popleft()
        began, before = past[0]
        if now - began < 0.5 * WINDOW:
            return _NONE
        return vector(turn(orientation, before) / (now - began))
