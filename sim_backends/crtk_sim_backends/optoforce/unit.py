"""The simulated unit: what acts on its sensors, what it measures of that, and how it is set."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

from crtk_sim_backends.page import Gauge, Gauges

PERIOD: Final = 0.001
"""Seconds of its own cycle."""
AXES: Final = {"3-axis": (1, 3), "6-axis": (1, 6), "4x3-axis": (4, 3)}
"""Sensors, and axes of each."""
NAMES: Final = ("fx", "fy", "fz", "mx", "my", "mz")
COUNTS: Final = (400.0,) * 3 + (2000.0,) * 3
"""Counts of a newton and of a newton metre."""
RATED: Final = 30000
"""Counts beyond which an axis is overloaded; it measures no more than that."""
CUTOFFS: Final = {0: 0.0, 1: 500.0, 2: 150.0, 3: 50.0, 4: 15.0, 5: 5.0, 6: 1.5}
"""Hz of its low-pass, by code; 0: none."""
PERIODS: Final = (0, 1, 3, 10, 33, 100)
"""Of its cycles, from one measurement that is sent to the next; 0: it sends none."""
DEFAULT: Final = (10, 4)
"""Period and filter with which it begins."""
ZERO: Final = 255
APART: Final = 0.002
"""Seconds between two configurations."""


class Unit:
    """One unit.

    Args:
        sensor: a key of `AXES`.
        noise: standard deviation of each force, in N.
        clock: seconds.
    """

    def __init__(
        self, sensor: str, noise: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.sensors, self.axes = AXES[sensor]
        self.loads = [[0.0] * 6 for _ in range(self.sensors)]
        self.carried = [0.0] * 6
        self.status_word = 0
        self.frozen = self.stopped = False
        self.configured = 0
        self._noise = noise
        self._clock = clock
        self._random = random.Random(7)
        self._filtered = [0.0] * (self.sensors * self.axes)
        self.restart()

    def restart(self) -> None:
        """Begin as after it was switched on."""
        self.period, self.filter = DEFAULT
        self.zero = [0.0] * len(self._filtered)
        self.is_zeroed = False
        self.number = 0
        self.counts = [0] * len(self._filtered)
        self._cycle = self._due = 0
        self._configured_at = -math.inf

    def configure(self, period: int, low_pass: int, zero: int) -> int:
        """Take a configuration; return its error, 0: it is taken.

        A unit that is zeroed is not zeroed again, and one that was just configured takes nothing.
        """
        too_soon = self._clock() - self._configured_at < APART
        unknown = period not in PERIODS or low_pass not in CUTOFFS or zero not in (0, ZERO)
        if too_soon or unknown or (zero and self.is_zeroed):
            return 1
        self.configured += 1
        self._configured_at = self._clock()
        self.period, self.filter, self.is_zeroed = period, low_pass, bool(zero)
        self.zero = list(self._filtered) if zero else [0.0] * len(self._filtered)
        return 0

    def advance(self) -> tuple[int, int, list[int]] | None:
        """Let one cycle pass; return number, status and counts of what is to be sent, None if nothing is."""
        self._cycle += 1
        self._measure()
        if not self.period or self.stopped or self._cycle < self._due:
            return None
        self._due = self._cycle + self.period
        overloaded = 0
        if not self.frozen:
            self.number = (self.number + 1) % 65536
            raw = [value - zero for value, zero in zip(self._filtered, self.zero, strict=True)]
            self.counts = [max(-RATED, min(RATED, round(value))) for value in raw]
            overloaded = self._overloaded(self._filtered)
        return self.number, overloaded | self.status_word, self.counts

    def _measure(self) -> None:
        cutoff = CUTOFFS[self.filter]
        share = 1.0 - math.exp(-2.0 * math.pi * cutoff * PERIOD) if cutoff else 1.0
        at = 0
        for load in self.loads:
            for axis in range(self.axes):
                noise = self._random.gauss(0.0, self._noise * (1.0 if axis < 3 else 0.1))
                acting = (load[axis] + self.carried[axis] + noise) * COUNTS[axis]
                self._filtered[at] += share * (acting - self._filtered[at])
                at += 1

    def _overloaded(self, counts: Sequence[float]) -> int:
        """Return the bits of what is overloaded, and which sensor it is."""
        bits, sensors = 0, set()
        for at, count in enumerate(counts):
            if abs(count) > RATED:
                bits |= 0x200 >> (at % self.axes)
                sensors.add(at // self.axes + 1)
        if self.sensors == 1 or not sensors:
            return bits
        return bits | (8 if len(sensors) > 1 else 0) | min(sensors)

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {
            "period": self.period,
            "filter": self.filter,
            "zeroed": self.is_zeroed,
            "configured": self.configured,
            "number": self.number,
            "counts": self.counts,
        }

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        rows: list[Gauges] = []
        for sensor in range(self.sensors):
            part = self.counts[sensor * self.axes : (sensor + 1) * self.axes]
            values = [count / scale for count, scale in zip(part, COUNTS, strict=False)]
            forces: list[Gauge] = [
                {"name": name, "low": -75.0, "high": 75.0, "value": value}
                for name, value in zip(NAMES[:3], values, strict=False)
            ]
            title = f"Forces {sensor + 1}" if self.sensors > 1 else "Forces"
            rows.append({"title": title, "unit": "N", "rate": "", "digits": 2, "gauges": forces})
            moments: list[Gauge] = [
                {"name": name, "low": -15.0, "high": 15.0, "value": value}
                for name, value in zip(NAMES[3:], values[3:], strict=False)
            ]
            if moments:
                rows.append(
                    {"title": "Moments", "unit": "N·m", "rate": "", "digits": 3, "gauges": moments}
                )
        return rows
