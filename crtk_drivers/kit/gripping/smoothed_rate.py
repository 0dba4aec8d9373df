"""How fast fingers move, out of openings that come in steps."""

from __future__ import annotations

__all__ = ["SmoothedRate"]


SEEN = 0.5
"""Share of the time constant for which an opening stays the same until fingers are seen to rest."""


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
        self._still_since = 0.0
        self._last: tuple[float, float, float] | None = None  # when, where, how fast

    def at(self, now: float, position: float, *, rests: bool = False) -> float:
        """Take what was measured, and return the velocity.

        Args:
            now: when, in s.
            position: that was measured.
            rests: the fingers say that they rest. Once they are seen to, as well, the velocity is 0.
        """
        before, was, velocity = self._last or (now, position, 0.0)
        elapsed = now - before
        if not rests or position != was:
            self._still_since = now
        elif now - self._still_since >= SEEN * self._settling:
            velocity = 0.0
        if elapsed > 0.0:
            share = elapsed / (self._settling + elapsed)
            velocity += share * ((position - was) / elapsed - velocity)
        self._last = now, position, velocity
        return velocity
