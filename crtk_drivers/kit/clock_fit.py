"""The time of each measurement, from the arrival of records and the device's own clock. Pure.

A record never arrives before it was sent, and mostly a little later: the arrivals plotted over the device's
clock lie above a straight line. `ClockFit` finds that line, the lower envelope, from the earliest arrivals of
the last seconds, and gives each measurement its time on it. Delays of single records, and of whole bursts,
leave no trace; what the network takes at the least cannot be told from the time of the measurement.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

BLOCK: Final = 0.25
"""Seconds of which the earliest arrival enters the fit."""
BLOCKS: Final = 40
QUICK: Final = 10_000
"""ns between two readings of a clock in which a process that is not interrupted reads another."""
ASTRAY: Final = 0.05
"""Seconds between the line and a whole block of arrivals at which the line counts as wrong."""

Seconds = NDArray[np.float64]
Point = tuple[float, float]
"""Ticks and seconds, from the origin of the fit."""


class ClockFit:
    """Follows the clock of one device."""

    def __init__(self) -> None:
        self.resets = -1
        self.reset()

    def reset(self) -> None:
        """Begin anew: the clock jumped, or runs at another rate."""
        self.resets += 1
        self._origin: tuple[int, float] | None = None
        self._points: deque[Point] = deque(maxlen=BLOCKS)
        self._line: tuple[float, float] | None = None
        self._block_end = 0.0
        self._first_block: list[tuple[NDArray[np.float64], Seconds]] = []
        self._best: tuple[float, Point] | None = None
        self._last = -np.inf
        self._jitter: list[Seconds] = []
        self._jitter_figures = (0.0, 0.0, 0.0)

    @property
    def locked(self) -> bool:
        """Whether there is a line; until then the arrival counts as the time of the measurement."""
        return self._line is not None

    @property
    def tick_rate(self) -> float:
        """The rate of the device's clock on ours, in Hz; 0 if it is not known yet."""
        return 1.0 / self._line[1] if self._line is not None else 0.0

    @property
    def jitter(self) -> tuple[float, float, float]:
        """How much later than on the line records arrived in the last block: p50, p99 and most, in s."""
        return self._jitter_figures

    def stamp(self, ticks: NDArray[np.int64], arrivals: Seconds) -> Seconds:
        """Return the time of each measurement, never later than its arrival, never going back.

        Args:
            ticks: number of each measurement (n,), ascending.
            arrivals: of its record (n,), monotonic seconds.
        """
        if self._origin is None:
            self._origin = int(ticks[0]), float(arrivals[0])
            self._block_end = float(arrivals[0]) + BLOCK
        x = (ticks - self._origin[0]).astype(np.float64)
        y = arrivals - self._origin[1]
        late = self._add(x, y)
        # Line and arrivals ascend, and so does the earlier of the two; only the line itself may move back.
        stamps = arrivals if late is None else arrivals - np.maximum(late, 0.0)
        if stamps[0] < self._last:
            stamps = np.maximum(stamps, self._last)
        self._last = float(stamps[-1])
        if arrivals[-1] >= self._block_end:
            self._end_block()
            self._block_end = float(arrivals[-1]) + BLOCK
        return stamps

    def time_of(self, tick: int) -> float | None:
        """Return the time of a measurement by the line, which it does not enter; None while there is none."""
        if self._line is None or self._origin is None:
            return None
        base, slope = self._line
        return self._origin[1] + base + slope * (tick - self._origin[0])

    def _add(self, x: Seconds, y: Seconds) -> Seconds | None:
        """Enter points; return how late each is, None if that is not known yet."""
        if self._line is None:
            self._first_block.append((x, y))
            return None
        base, slope = self._line
        late = y - (base + slope * x)
        index = int(late.argmin())
        if self._best is None or late[index] < self._best[0]:
            self._best = float(late[index]), (float(x[index]), float(y[index]))
        self._jitter.append(late)
        return late

    def _end_block(self) -> None:
        if self._line is None:
            xs = np.concatenate([x for x, _ in self._first_block])
            ys = np.concatenate([y for _, y in self._first_block])
            points = list(zip(xs.tolist(), ys.tolist(), strict=True))
            self._line = lower_envelope(points)
            self._first_block.clear()
            if self._line is not None:
                _, slope = self._line
                index = int((ys - slope * xs).argmin())
                self._points.append(points[index])
            return
        if self._best is None:
            return
        off, point = self._best
        self._best = None
        if abs(off) > ASTRAY:
            self.reset()
            return
        late = np.concatenate(self._jitter)
        self._jitter.clear()
        p50, p99 = np.percentile(late, (50, 99)).tolist()
        self._jitter_figures = max(p50, 0.0), max(p99, 0.0), max(float(late.max()), 0.0)
        self._points.append(point)
        if len(self._points) > 1:
            self._line = lower_envelope(list(self._points)) or self._line


def lower_envelope(points: list[Point]) -> tuple[float, float] | None:
    """Return base and slope of the line below all points that has the least distance to them in sum.

    That is the edge of their lower hull beneath their mean. None: fewer than two of them, or no slope.

    Args:
        points: sorted by their first coordinate.
    """
    hull: list[Point] = []
    for x, y in points:
        if hull and x <= hull[-1][0]:
            continue
        while len(hull) > 1:
            (ax, ay), (bx, by) = hull[-2], hull[-1]
            if (by - ay) * (x - ax) < (y - ay) * (bx - ax):
                break
            hull.pop()
        hull.append((x, y))
    if len(hull) < 2:
        return None
    mean = sum(x for x, _ in points) / len(points)
    edge = 0
    while edge < len(hull) - 2 and hull[edge + 1][0] < mean:
        edge += 1
    (ax, ay), (bx, by) = hull[edge], hull[edge + 1]
    slope = (by - ay) / (bx - ax)
    return (ay - slope * ax, slope) if slope > 0.0 else None


class WallClock:
    """From monotonic time to time since the epoch, without the moments in which this process stood still.

    Two clocks cannot be read at once. Between the two readings the process may have to wait, and what they
    seem to differ by is then wrong by as much: such a reading counts only when it shows that one was set.

    Args:
        monotonic, wall: the clocks, in ns.
    """

    def __init__(
        self,
        monotonic: Callable[[], int] = time.monotonic_ns,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        self._monotonic = monotonic
        self._wall = wall
        self._offset: int | None = None

    def offset(self) -> int:
        """Return by how much the time since the epoch is ahead, in ns."""
        before = self._monotonic()
        wall = self._wall()
        after = self._monotonic()
        offset = wall - (before + after) // 2
        doubt = max(QUICK, after - before)
        if self._offset is None or after - before <= QUICK or abs(offset - self._offset) > doubt:
            self._offset = offset
        return self._offset
