"""Whether another program reads the same boards. Pure.

A board tells with its state how long ago that was read before (register block 0, quadlet 0: reading sets the
counter back). Nobody but us has read it, so that must be at least the time from the answer before to this
question. If it is less, somebody has read in between: no delay of ours, and no lost or doubled packet before
that answer, makes it less.
"""

from __future__ import annotations

from collections import deque
from typing import Final

_CLOCKS: Final = 1e-3
"""By how much of a time clocks may differ."""

_ALWAYS: Final = 2e-4
"""Seconds that are always allowed."""

_SEEN: Final = 3
_WITHIN: Final = 1.0
"""How often, in how many seconds, somebody must have read: a request may be doubled on its way."""


class OtherReaders:
    """Watches one board."""

    def __init__(self) -> None:
        self._answered = 0.0
        self._is_answered = False
        self._gap: float | None = None  # least seconds that the next answer must tell
        self._seen: deque[float] = deque(maxlen=_SEEN)

    def asked(self, at: float) -> None:
        """The board is asked for its state, at monotonic seconds."""
        self._gap = at - self._answered if self._is_answered else None
        self._is_answered = False

    def answered(self, elapsed: float, at: float) -> None:
        """It has answered, at monotonic seconds, that it was read `elapsed` seconds before."""
        if self._gap is not None and elapsed * (1.0 + _CLOCKS) + _ALWAYS < self._gap:
            self._seen.append(at)
        self._answered, self._is_answered = at, True

    def are_there(self, now: float) -> bool:
        """Whether another program reads the board."""
        return len(self._seen) == _SEEN and now - self._seen[0] <= _WITHIN
