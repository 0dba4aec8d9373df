"""How old messages are when they come, by the stamps of a clock that need not agree with ours. Pure."""

from __future__ import annotations

from typing import Final

import numpy as np

__all__ = ["Ages"]

WINDOW: Final = 10.0
"""Seconds over which the earliest arrival counts: clocks of two machines drift by less than 1 ms in it."""
REAL: Final = 1e9
"""Seconds from which on a stamp is of a real clock, which nobody pauses; simulated ones begin at 0."""


class Ages:
    """When messages of one sender were stamped on our clock, from when the earliest of the last seconds came.

    Clocks of the sender and of this machine need not agree, and simulated time is one of these. A clock that
    was set back is another one.
    """

    def __init__(self) -> None:
        self._least = np.inf
        self._next = np.inf
        self._until = -np.inf
        self._newest = -np.inf

    @property
    def lasts(self) -> bool:
        """Whether it holds for another connection: nobody pauses the clock in between."""
        return self._newest > REAL

    def acquired(self, stamp_ns: int, arrival: float) -> float:
        """Return the monotonic seconds of a stamp; never later than its arrival."""
        stamp = stamp_ns * 1e-9
        late = arrival - stamp
        if stamp < self._newest:
            self._least = self._next = late
            self._until = arrival + WINDOW
        self._newest = stamp
        if arrival > self._until:
            self._least, self._next = min(self._next, late), late
            self._until = arrival + WINDOW
        self._least, self._next = min(self._least, late), min(self._next, late)
        return min(arrival, stamp + self._least)
