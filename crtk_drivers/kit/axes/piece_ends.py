"""Where the pieces end that fill a controller's buffer (PVT), along a stream of positions."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["PieceEnds"]


class PieceEnds:
    """The ends of pieces of equal time. No I/O, and no clock.

    None is further than an axis may go in its time: after a buffer that ran empty the stream is far ahead.

    Args:
        most: counts that each of n axes goes in a piece at most.

    Attributes:
        at: the last end, (n,) counts.
    """

    def __init__(self, most: Sequence[float]) -> None:
        self._most = most
        self.at: list[float] = []

    def begin(self, here: Sequence[float]) -> None:
        """The first piece begins at counts (n,)."""
        self.at = list(here)

    def towards(self, goal: Sequence[float]) -> list[float]:
        """Return the way of one more piece, (n,) counts, towards where the stream was, (n,)."""
        ways = [
            max(-most, min(most, end - begin))
            for most, begin, end in zip(self._most, self.at, goal, strict=True)
        ]
        self.at = [begin + way for begin, way in zip(self.at, ways, strict=True)]
        return ways
