"""When each control period begins on the wall clock, and how well that is kept."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Final

LATE: Final = 0.001
"""Seconds after which a period counts as late."""

_CATCH_UP_SPEED: Final = 2.0  # times the pace, at which delayed periods are made up for
_CATCH_UP_LIMIT: Final = 0.1  # s; after a longer delay the periods are left out
_WINDOW: Final = 1.0  # s over which the pace is measured
_TOLERATED: Final = 0.95  # part of the wanted pace below which a warning is due
_WARNING_PERIOD: Final = 10.0  # s

log = logging.getLogger(__name__)


@dataclass
class Statistics:
    """How well the loop keeps its times; all of them are of the wall clock."""

    ticks: int = 0
    late: int = 0  # periods that began more than `LATE` late
    skipped: int = 0  # periods left out after a long delay
    worst_delay: float = 0.0  # s
    busy: float = 0.0  # s spent in periods, waiting excluded
    accepted: int = 0  # connections
    rtde_dropped: int = 0  # packages that slow RTDE clients did not get
    defects: int = 0  # connections that an unexpected error of the simulator closed


class Pace:
    """Control periods, `speed` times as fast as real time.

    A delay of up to 0.1 s is made up for; after a longer one, or when the machine is too slow for good,
    periods are left out: they are counted, and a warning says how fast it really goes.

    Args:
        period: of the controller, in s of its own time.
        speed: seconds of the controller in one of the wall clock.
        statistics: where delays are counted.

    Attributes:
        speed: that is wanted.
        due: when the next period should begin, monotonic s.
        wake: when it may begin: later, while delays are made up for.
        reached: speed over the last second or so; the wanted one before that is measured.
    """

    def __init__(self, period: float, speed: float, statistics: Statistics) -> None:
        self._period = period
        self.speed = speed
        self._wall = period / speed
        self._statistics = statistics
        self.due = self.wake = 0.0
        self._periods = 0  # since the window of measurement began
        self._window = 0.0
        self._warned = -_WARNING_PERIOD
        self.reached = speed

    def begin(self, now: float) -> None:
        """Let the first period be due one period after `now`, monotonic s."""
        self.due = self.wake = now + self._wall
        self._window = now
        self._periods = 0

    def started(self, now: float) -> float:
        """Note that the period that was due has begun, plan the next, and return how late it is, s."""
        late = now - self.due
        statistics = self._statistics
        statistics.worst_delay = max(statistics.worst_delay, late)
        if late > LATE:
            statistics.late += 1
        left_out = int(late / self._wall) if late > _CATCH_UP_LIMIT else 0
        if left_out:
            statistics.skipped += left_out
            self.due = now
        self.due += self._wall
        self.wake = max(self.due, now + self._wall / _CATCH_UP_SPEED)
        self._periods += 1
        if now - self._window >= _WINDOW:
            self._measure(now)
        return late

    def _measure(self, now: float) -> None:
        self.reached = self._periods * self._period / (now - self._window)
        self._window = now
        self._periods = 0
        too_slow = self.reached < _TOLERATED * self.speed
        if too_slow and now - self._warned >= _WARNING_PERIOD:
            self._warned = now
            log.warning(
                "the machine does not keep up: the controller's time passes %.2g times as fast as "
                "real time, not %g times; %d periods have been left out",
                self.reached,
                self.speed,
                self._statistics.skipped,
            )
