"""How fast fingers move, out of openings that come in steps."""

from __future__ import annotations

__all__ = ["SmoothedRate"]


class SmoothedRate:
    """Of one joint.

    Args:
        settling: its time constant, in s.
    """

    def __init__(self, settling: float) -> None:
        self._settling = settling
        self.begin()

    def begin(self) -> None:
        """A connection begins: nothing was measured."""
        self._last: tuple[float, float, float] | None = None  # when, where, how fast

    def at(self, now: float, position: float) -> float:
        """Take what was measured at a time in s, and return the velocity."""
        before, was, velocity = self._last or (now, position, 0.0)
        elapsed = now - before
        if elapsed > 0.0:
            share = elapsed / (self._settling + elapsed)
            velocity += share * ((position - was) / elapsed - velocity)
        self._last = now, position, velocity
        return velocity
