"""How old a state of the controller may be, by the packages that it is an answer to.

A network that holds packages back delivers states one after the other, as they were made, but late: neither
their arrival nor the controller's time stamps, which come from another clock, show it. What is sent to the
controller has a number here, and a state that answers it was made after it had left: one that comes behind
the reply to a request on its connection, or that names the package which the control program has seen.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

__all__ = ["Echoes"]

CLOCK_ERROR: Final = 1e-3
"""Seconds in a second by which the controller's clock is expected to differ from ours at most."""

MOST_NUMBERS: Final = 2**20
"""Numbers of packages go from 1 to this, then from 1 on."""

KEPT: Final = 1000
"""Packages of which it is known when they left: two seconds of a stream at 500 Hz."""


class Echoes:
    """When packages left, and what the states say that answer them. Times are in monotonic seconds."""

    def __init__(self) -> None:
        self._number = 0
        self._left: deque[tuple[int, float]] = deque(maxlen=KEPT)
        self._seen = 0
        self._lead = -math.inf
        self._seen_at = -math.inf

    def leaves(self, now: float) -> int:
        """Return the number of a package that leaves now."""
        self._number = self._number % MOST_NUMBERS + 1
        self._left.append((self._number, now))
        return self._number

    def begin(self) -> None:
        """Forget what was seen: another program answers, or the controller's clock began anew."""
        self._seen = 0
        self._lead = self._seen_at = -math.inf

    @property
    def began(self) -> bool:
        """Whether anything was seen since `begin`."""
        return self._seen > 0

    def take(self, number: int, timestamp: float) -> None:
        """Take what a state says: the package seen last, and the controller's time at which it was made."""
        if number == self._seen:
            return
        while self._left:
            known, left = self._left.popleft()
            if known == number:
                # By how much our clock is ahead of the controller's, at least.
                worn = self._lead - CLOCK_ERROR * (timestamp - self._seen_at)
                self._lead = max(worn, left - timestamp)
                self._seen, self._seen_at = number, timestamp
                return

    def age(self, received: float, timestamp: float) -> float:
        """Return how old a state may have been when it was received, s; 0 as long as that is not known."""
        return max(0.0, received - timestamp - self._lead) if self.began else 0.0
