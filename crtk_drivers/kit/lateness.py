"""How old a record of a stream is when it comes: by the device's clock, and by when others came. Pure."""

from __future__ import annotations

import math
from typing import Final

__all__ = ["Lateness"]

SETTLES: Final = 0.1
RECORDS: Final = 8
"""Seconds, and records, of a stream that flows after which a delay that stays is none: the network's own way,
or a device that stood still."""

HELD_UP: Final = 0.1
"""Seconds by which a record is late at the least that a port kept while this computer stood still."""


class Lateness:
    """Of one stream.

    What the network, or a port, kept and delivers at once is late by what it waited. What all records take at
    the least cannot be told.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """A stream begins: its first record counts as made when it comes."""
        self._came = math.nan
        self._late = 0.0
        self._begin_block()

    def _begin_block(self) -> None:
        self._flowed, self._records, self._least = 0.0, 0, math.inf

    def of(self, passed: float, now: float) -> float:
        """Return by how many seconds the record that comes now is late.

        Args:
            passed: seconds since the one before was made, by the device's clock.
            now: monotonic seconds.
        """
        waited, self._came = now - self._came, now
        if math.isnan(waited) or passed <= 0.0:
            self._late = 0.0
            return 0.0
        self._late = max(0.0, self._late + waited - passed)
        self._least = min(self._least, self._late)
        self._flowed += min(waited, passed)
        self._records += 1
        if self._flowed >= SETTLES and self._records >= RECORDS:
            self._late -= self._least
            self._begin_block()
        return self._late

    def held_up(self, passed: float, now: float) -> float:
        """As `of`; 0 for what no standstill of this computer need explain."""
        late = self.of(passed, now)
        return late if late > HELD_UP else 0.0
