"""A stream of positions as points with velocity and time (PVT) for the buffer of each drive. No I/O.

A point is where an axis is, how fast, and how long it takes to the next point. Rows of points, one for each
axis, are made from where the setpoints were some time ago, when the host's clock says that one more is
needed. Drives have clocks of their own: what each one has left in its buffer corrects when it is at the end
of what it was sent, and so how long its next point takes.

Whether a drive has taken a point whose answer was lost follows from how many its buffer holds.

Source: ASCII Programmer's Guide, 0x115; for the meaning of a point the vendor's PVT_Serial_Example.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from crtk_drivers.kit import Trail
from crtk_drivers.kit.axes import PieceEnds

__all__ = ["Buffer", "Point", "PvtStream", "delay_of"]

SURE: Final = 3
"""Readings of a buffer that are clear and agree, after which it is known how it counts."""
_GAIN: Final = 0.2
_EDGE: Final = 0.15
"""Share of the period in which a reading may be of before or after a point was taken out."""
_HASTE: Final = 1.1
"""How fast a stream that is behind catches up, of real time."""
_THERE: Final = 0.8
"""Share of its velocity limit with which an axis goes to a stream that is far away, before it makes haste."""
_EASE: Final = 0.1
"""By how much its pace grows from one row to the next."""
_STRETCH: Final = 2
"""Milliseconds by which a point may be longer or shorter than the period."""


def delay_of(period: float, lead: int) -> float:
    """Return the seconds after which an axis is where it was sent."""
    return (lead + 1.5) * period


class Point(NamedTuple):
    """What is sent for one axis.

    Attributes:
        time: to the next point, in ms.
        position: in counts.
        velocity: in counts/s.
    """

    time: int
    position: int
    velocity: float


class Buffer:
    """The buffer of one drive.

    Args:
        period: from one point to the next, in s.

    Attributes:
        capacity: places that are free when it is empty.
        end: monotonic s at which the drive is at its last point, and must have another one.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self.capacity = 0
        self._readings = 0
        self._offset = 0.5  # points whose time has not come are in it, as it seems
        self.begin(0.0)

    def begin(self, end: float) -> None:
        """The stream begins; the points that were sent last until `end`."""
        self.end = end
        self._next = self._period  # s from the last point to the one after it, as it was sent

    def take(self, due: float) -> int:
        """Count one more point, and return its time in ms.

        Args:
            due: monotonic s at which the point after it is to be reached.
        """
        self.end += self._next
        usual = round(1000.0 * self._period)
        time = max(usual - _STRETCH, min(usual + _STRETCH, round(1000.0 * (due - self.end))))
        self._next = time / 1000.0
        return time

    def _excess(self, free: int, unsent: int, now: float) -> float:
        """Return how many points more it holds than its end tells: within a half, while that is right."""
        held = self.capacity - free + unsent
        return held - (self.end - now) / self._period - self._offset

    def heard(self, free: int, unsent: int, now: float) -> None:
        """Take how many places were free at a time, which tells how fast the drive's clock is.

        Args:
            free: what it told.
            unsent: points that `take` has counted and that were not sent yet.
            now: monotonic seconds.
        """
        excess = self._excess(free, unsent, now)
        if self._readings < SURE:  # firmware may count the point that is carried out, or not
            more = round(excess)
            if more:
                self._offset += more
                self._readings = 0
            if abs(excess - more) < 0.5 - _EDGE:
                self._readings += 1
        elif 0.5 < abs(excess) < 1.5:
            self.end += _GAIN * self._period * (excess - math.copysign(0.5, excess))

    def has_taken(self, free: int, unsent: int, now: float) -> bool | None:
        """Whether it holds the last point that was sent; None: it is just about to take one out."""
        excess = self._excess(free, unsent, now)
        if abs(excess) < 0.5 - _EDGE:
            return True
        return False if abs(excess + 1.0) < 0.5 - _EDGE else None

    @property
    def is_sure(self) -> bool:
        """Whether it is known how it counts."""
        return self._readings >= SURE


class PvtStream:
    """The points of one stream for all axes.

    Args:
        fastest: velocities of the axes (n,) in counts/s, beyond which no point goes.
        period: from one point to the next, in s.
        lead: points that wait in the drives.

    Attributes:
        buffers: of the drives.
    """

    def __init__(self, fastest: Sequence[float], period: float, lead: int) -> None:
        self._fastest = fastest
        self._period = period
        self._lead = lead
        self._delay = delay_of(period, lead)
        self._trail = Trail(2000)
        self.buffers = [Buffer(period) for _ in fastest]
        self._end = 0.0
        self._ends = PieceEnds([most * period for most in fastest])
        self._due: float | None = None  # of the last row, in the time of setpoints
        self._pace = 1.0
        self._newest: list[float] = []
        self._changed = 0.0
        self._is_running = False

    @property
    def is_running(self) -> bool:
        """Whether the drives go along it."""
        return self._is_running

    def forget(self) -> None:
        """The stream has ended."""
        self._trail.begin()
        self._is_running = False
        self._due, self._pace = None, 1.0

    def interrupt(self) -> None:
        """The drives stand: once they go again, it goes on from here, slowly at first."""
        self._is_running = False
        self._pace = 0.0

    def add(self, now: float, counts: Sequence[float]) -> None:
        """Take a setpoint, (n,) in counts."""
        self._trail.add(now, counts)
        if self._due is None:
            self._due = now
        if list(counts) != self._newest:
            self._newest, self._changed = list(counts), now

    def stand(self, here: Sequence[int]) -> list[list[Point]]:
        """Return the first rows, which stand where the axes are told to be.

        Where the stream is further away than a point may be, they go there first, slowly at first.
        """
        self._ends.begin(here)
        if self._due is not None:
            self._go_there(here, self._due)
        row = [Point(round(1000.0 * self._period), place, 0.0) for place in here]
        return [row] * (self._lead + 1)

    def _go_there(self, here: Sequence[int], due: float) -> None:
        there = self._trail.at(due)
        needed = max(
            abs(end - begin) / most
            for begin, end, most in zip(here, there, self._fastest, strict=True)
        )
        if needed > self._period:
            self._due = due - needed / _THERE
            self._trail.lead_in(self._due, here, due)
            self._pace = 0.0

    def started(self, times: Sequence[float]) -> None:
        """The drives go, each since one of these monotonic times (n,)."""
        self._is_running = True
        self._end = min(times) + self._lead * self._period
        for buffer, since in zip(self.buffers, times, strict=True):
            buffer.begin(since + self._lead * self._period)

    def is_late(self, now: float, unsent: Sequence[int]) -> bool:
        """Whether a drive is at the end of what it has, and has stopped there.

        Args:
            now: monotonic seconds.
            unsent: points of each axis (n,) that are counted, and not known to be taken.
        """
        return self._is_running and any(
            now > buffer.end - waiting * self._period
            for buffer, waiting in zip(self.buffers, unsent, strict=True)
        )

    def has_arrived(self, now: float) -> bool:
        """Whether the drives were sent to where the newest setpoint is, and should be there by now."""
        if self._due is None:
            return True
        return self._is_running and self._due - (self._end - now) >= self._changed

    def rows(self, now: float) -> list[list[Point]]:
        """Return the rows that are needed by now."""
        found = []
        while self._is_running and self._end - now < self._lead * self._period:
            self._end += self._period
            found.append(self._row(self._end))
        return found

    def _row(self, end: float) -> list[Point]:
        """Return the points that are reached at a time of the host's clock."""
        due = self._advance(end - self._delay)
        half = 0.5 * self._period
        before, there, after = (self._trail.at(due + shift) for shift in (-half, 0.0, half))
        self._ends.towards(there)
        row = []
        for axis, buffer in enumerate(self.buffers):
            most = self._fastest[axis]
            rate = self._pace * (after[axis] - before[axis]) / self._period
            behind = there[axis] - self._ends.at[axis]
            if abs(behind) > 1.0:  # it goes on with the next piece
                rate = behind / self._period
            time = buffer.take(end + self._period)
            row.append(Point(time, round(self._ends.at[axis]), max(-most, min(most, rate))))
        return row

    def _advance(self, wanted: float) -> float:
        """Return the time of setpoints that is next; what is behind catches up, after a stop from rest."""
        last = wanted if self._due is None else self._due
        self._pace = min(self._pace + _EASE, _HASTE)
        step = min(wanted - last, self._pace * self._period)
        self._pace = max(0.0, step / self._period)
        self._due = last + max(0.0, step)
        return self._due
