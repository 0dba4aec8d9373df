"""Which records count: lost, repeated and late ones, new series, restarts of the sensor. Pure.

A record has two numbers, named as those of a NetFT. ``rdt_sequence`` counts the records of one request and
begins with 1; ``ft_sequence`` counts the sensor's own measurements since it was switched on and is its clock.
Both have 32 bits and wrap. A sensor with one counter gives it for both.

A record that follows is accepted, and what lies between was lost; one that was lost and comes after all is
late: it is dropped, being too old for the stream, and is not lost any more; one that repeats another is a
duplicate. What fits neither is the beginning of a new series: expected after a request of ours, otherwise
somebody else's doing, and after a restart of the sensor if its clock did not go on as it should.
"""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

LATEST: Final = 1024
"""A record that is late by more than so many belongs to another series."""
TOO_LATE: Final = 1.0
"""Seconds, on either clock, by which no record is late: those who send may be held up for less."""
FIRST: Final = 65536
"""A series that begins later than this with a request of ours did not begin with it."""
FROZEN_AFTER: Final = 64
"""Records in a row with the same ``ft_sequence`` after which the transducer counts as frozen."""
SLACK: Final = 0.25
"""Share of the time that passed by which the sensor's clock may be off."""

_WRAP: Final = 1 << 32
_HALF: Final = 1 << 31
_MOST: Final = 1 << 15
_COUNT: Final = np.arange(1, _MOST + 1, dtype=np.uint32)


class Event(StrEnum):
    """What happened to the stream as a whole."""

    BEGUN = "begun"
    """The series that was asked for has begun."""
    TAKEN_OVER = "taken over"
    """A series began that was not asked for: another client has its hands on the sensor."""
    RESTARTED = "restarted"
    """The sensor's clock began anew: it was off. Its bias is gone, its scale may be another."""
    FROZEN = "frozen"
    """Records come, but the same measurement again and again."""
    THAWED = "thawed"
    """The measurements go on."""


@dataclass(slots=True)
class Counters:
    """Records so far, and what became of them."""

    received: int = 0
    lost: int = 0
    gaps: int = 0
    duplicates: int = 0
    late: int = 0
    series: int = 0
    takeovers: int = 0
    restarts: int = 0
    frozen: int = 0

    def as_dict(self) -> dict[str, float]:
        """Return them by name."""
        return {name: float(value) for name, value in asdict(self).items()}


class Accepted(NamedTuple):
    """What of a batch counts.

    `keep` are the indices of the records to keep, None for all of them; `ticks` (k,) their ``ft_sequence``
    without its wraps; `events` what happened, with the index in `ticks` from which on it is so.
    """

    keep: NDArray[np.intp] | None
    ticks: NDArray[np.int64]
    events: tuple[tuple[Event, int], ...] = ()


class SequenceTracker:
    """Follows the two numbers.

    Args:
        rate: of the sensor's clock, in Hz; off by a quarter at most.
    """

    def __init__(self, rate: float) -> None:
        self.counters = Counters()
        self.frozen = False
        self.step = 0
        """Measurements from one record to the next."""
        self.rate = rate
        self._expecting = False
        self._any = False
        self._rdt = 0
        self._ft = 0
        self._ticks = 0
        self._when = 0.0
        self._same = 0
        self._missing: deque[int] = deque(maxlen=LATEST)

    def expect_series(self) -> None:
        """The stream was asked for: the next series that begins is ours."""
        self._expecting = True

    def take(
        self, rdt: NDArray[np.uint32], ft: NDArray[np.uint32], when: NDArray[np.float64]
    ) -> Accepted:
        """Follow a batch of records.

        Args:
            rdt, ft: the two numbers (n,).
            when: monotonic seconds of the arrival (n,).
        """
        count = rdt.size
        if not count:
            return Accepted(None, np.empty(0, np.int64))
        self.counters.received += count
        accepted = self._take_plain(rdt, ft, when)
        return self._take_each(rdt, ft, when) if accepted is None else accepted

    def _take_plain(
        self, rdt: NDArray[np.uint32], ft: NDArray[np.uint32], when: NDArray[np.float64]
    ) -> Accepted | None:
        """Follow a batch that goes on at the same step; None if it does not."""
        step, count = self.step, rdt.size
        if not step or self._same or count > _MOST or count * step > self.rate:
            return None
        one_by_one = _COUNT[:count]
        rdts = one_by_one + np.uint32(self._rdt)
        fts = one_by_one * np.uint32(step) + np.uint32(self._ft)
        if (rdts != rdt).any() or (fts != ft).any():
            return None
        ticks = one_by_one * np.int64(step) + self._ticks
        self._rdt, self._ft = int(rdts[-1]), int(fts[-1])
        self._ticks, self._when = int(ticks[-1]), float(when[-1])
        return Accepted(None, ticks)

    def _take_each(
        self, rdt: NDArray[np.uint32], ft: NDArray[np.uint32], when: NDArray[np.float64]
    ) -> Accepted:
        keep: list[int] = []
        ticks: list[int] = []
        events: list[tuple[Event, int]] = []
        for index, numbers in enumerate(zip(rdt.tolist(), ft.tolist(), when.tolist(), strict=True)):
            accepted, happened = self._take_one(*numbers)
            events += [(event, len(ticks)) for event in happened]
            if accepted:
                keep.append(index)
                ticks.append(self._ticks)
        return Accepted(np.array(keep, np.intp), np.array(ticks, dtype=np.int64), tuple(events))

    def _take_one(self, rdt: int, ft: int, when: float) -> tuple[bool, list[Event]]:
        if not self._any:
            self._any = True
            self._rdt, self._ft, self._ticks, self._when = rdt, ft, ft, when
            return True, self._begin(rdt, [])
        ahead = (rdt - self._rdt) % _WRAP
        behind = -ahead % _WRAP
        passed = _signed(ft - self._ft)
        most = self._most(when - self._when)
        if 0 < ahead < _HALF and ahead <= most and 0 <= passed <= most:
            return True, self._follow(rdt, ft, when, ahead, passed)
        back = behind < _HALF
        fresh = self._expecting and back and (rdt == 1 < behind or rdt <= LATEST < behind)
        recent = when - self._when < TOO_LATE and passed >= -TOO_LATE * self.rate
        from_before = recent and (passed < 0 or (passed == 0 and behind <= LATEST))
        if from_before and not fresh:
            self._drop(rdt)
            return False, []
        return True, self._new_series(rdt, ft, when, passed)

    def _follow(self, rdt: int, ft: int, when: float, ahead: int, passed: int) -> list[Event]:
        if ahead > 1:
            self._miss(ahead - 1, rdt)
        elif passed:
            self.step = passed
        self._rdt, self._ft, self._when = rdt, ft, when
        self._ticks += passed
        if passed:
            return self._go_on()
        self._same += 1
        self.counters.frozen += 1
        if self._same == FROZEN_AFTER:
            self.frozen = True
            return [Event.FROZEN]
        return []

    def _go_on(self) -> list[Event]:
        """The measurements are not the one before any more."""
        self._same = 0
        was_frozen, self.frozen = self.frozen, False
        return [Event.THAWED] if was_frozen else []

    def _miss(self, count: int, before: int) -> None:
        """Count the records as lost that should have come before the one with the number `before`."""
        self.counters.lost += count
        self.counters.gaps += 1
        self._missing.extend((before - i) % _WRAP for i in range(min(count, LATEST), 0, -1))

    def _drop(self, rdt: int) -> None:
        if rdt in self._missing:
            self._missing.remove(rdt)
            self.counters.late += 1
            self.counters.lost -= 1
        else:
            self.counters.duplicates += 1

    def _new_series(self, rdt: int, ft: int, when: float, passed: int) -> list[Event]:
        waited = when - self._when
        off = abs((ft - self._ft - round(self.rate * waited) + _HALF) % _WRAP - _HALF)
        restarted = passed < 0 or off > self.rate * (TOO_LATE + SLACK * waited)
        self._rdt, self._ft, self._when = rdt, ft, when
        self._ticks = ft if restarted else self._ticks + passed
        events = self._go_on() if passed else []
        if restarted:
            self.counters.restarts += 1
            events.append(Event.RESTARTED)
        return self._begin(rdt, events)

    def _begin(self, rdt: int, events: list[Event]) -> list[Event]:
        self.counters.series += 1
        self._missing.clear()
        expected, self._expecting = self._expecting and rdt <= FIRST, False
        if expected:
            if rdt > 1:
                self._miss(rdt - 1, rdt)
            return [*events, Event.BEGUN]
        self.counters.takeovers += 1
        return [*events, Event.TAKEN_OVER]

    def _most(self, waited: float) -> float:
        """Return how many measurements may have been made in so many seconds."""
        return self.rate * (1.0 + (1.0 + SLACK) * max(0.0, waited))


def _signed(difference: int) -> int:
    """Return a difference of two 32-bit numbers as the shorter way between them."""
    return (difference + _HALF) % _WRAP - _HALF
