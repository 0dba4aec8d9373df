"""What a stream asked for lately, looked up between its points. No I/O, and no clock of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

__all__ = ["Trail"]


class Trail:
    """The last points of a stream, in the order of their times.

    Args:
        longest: how many are kept.
    """

    def __init__(self, longest: int = 64) -> None:
        self._points: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=longest)

    def begin(self) -> None:
        """Forget all: another stream begins."""
        self._points.clear()

    def add(self, at: float, point: Sequence[float]) -> None:
        """Take the newest point, and its time."""
        self._points.append((at, tuple(point)))

    def lead_in(self, at: float, point: Sequence[float], to: float) -> None:
        """Let the stream come from another point, and be on its own way at a time.

        Args:
            at: time of that point, before `to`.
            point: that one.
            to: a time at which the stream was somewhere; what came before it is left out.

        Raises:
            LookupError: there is no point yet.
        """
        there = self.at(to)
        while self._points and self._points[0][0] <= to:
            self._points.popleft()
        self._points.extendleft([(to, there), (at, tuple(point))])

    def at(self, due: float) -> tuple[float, ...]:
        """Return where the stream was at a time: between two points, or at the first or the last one.

        Raises:
            LookupError: there is no point yet.
        """
        later = self._points[-1]
        for earlier in reversed(self._points):
            if earlier[0] <= due:
                break
            later = earlier
        else:
            return later[1]
        if later[0] <= due:
            return later[1]
        share = (due - earlier[0]) / (later[0] - earlier[0])
        return tuple(a + share * (b - a) for a, b in zip(earlier[1], later[1], strict=True))
