"""What changes slowly (temperatures, voltages, errors), read in turn beside what is read in each cycle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

__all__ = ["RoundRobin"]

Item = TypeVar("Item")


class RoundRobin(Generic[Item]):
    """Says what is to be read now. No I/O and no clock.

    Args:
        items: what there is to read; never two at once.
        interval: seconds in which each has its turn once.
    """

    def __init__(self, items: Sequence[Item], interval: float) -> None:
        self._items = tuple(items)
        self._interval = interval
        self._turn = 0
        self._due = 0.0

    def due(self, now: float) -> Item | None:
        """Return what has its turn at the monotonic time `now`; None: nothing yet."""
        if not self._items or now < self._due:
            return None
        item = self._items[self._turn % len(self._items)]
        self._turn += 1
        self._due = now + self._interval / len(self._items)
        return item

    def restart(self) -> None:
        """Begin with the first again, at once."""
        self._turn, self._due = 0, 0.0
