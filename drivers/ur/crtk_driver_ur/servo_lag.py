"""By how much an arm lags behind the joint positions that it is streamed, in seconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

__all__ = ["ServoLag"]

SLOWEST: Final = 0.05
"""rad/s below which the way that is left says nothing about time."""

SMOOTHING: Final = 0.02
"""Weight of each sample: the figure is a mean over about fifty."""

THERE: Final = 2e-4
"""rad to the last position below which an arm that stands has no way left to go."""


class ServoLag:
    """The way from the measured to the commanded position, over the speed: a mean while the arm moves.

    `command` and `end` may be called from any thread, the rest belongs to one.

    Attributes:
        seconds: the lag; NaN before it could be measured. It is kept after the stream has ended.
    """

    def __init__(self) -> None:
        self.seconds = math.nan
        self._commanded: Sequence[float] = ()

    def command(self, q: Sequence[float]) -> None:
        """Take note of a joint position (n, rad) that was sent."""
        self._commanded = q

    def end(self) -> None:
        """Nothing is streamed any more."""
        self._commanded = ()

    def has_ended(self, q: Sequence[float]) -> bool:
        """Whether the positions `q` (n, rad) are those that were sent last."""
        sent = self._commanded
        return not sent or max(abs(c - x) for c, x in zip(sent, q, strict=True)) < THERE

    def measure(self, q: Sequence[float], qd: Sequence[float]) -> None:
        """Take note of measured positions and speeds (n each, rad and rad/s)."""
        commanded = self._commanded
        square = sum(v * v for v in qd)
        if not commanded or square < SLOWEST * SLOWEST:
            return
        ahead = sum((c - x) * v for c, x, v in zip(commanded, q, qd, strict=True))
        lag = ahead / square
        if math.isnan(self.seconds):
            self.seconds = lag
        else:
            self.seconds += SMOOTHING * (lag - self.seconds)
