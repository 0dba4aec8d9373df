"""The mean of a sensor's measurements over a while, taken while the I/O thread goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

__all__ = ["Average", "Averaging", "differ"]

Values = NDArray[np.float64]

SURE: Final = 6.0
"""Standard errors by which two means may differ."""
PARTS: Final = 5
"""Parts of an average, of whose deviations the median is its noise."""


@dataclass(frozen=True, eq=False)
class Average:
    """Of `count` measurements (6,).

    Attributes:
        mean, deviation: of all of them; the standard deviation.
        noise: the standard deviation without what changed from one part of them to another.
    """

    count: int
    mean: Values
    deviation: Values
    noise: Values


class Averaging:
    """Collects measurements.

    Args:
        seconds: for which measurements are taken.
        begin: monotonic seconds; what was measured before does not count.
    """

    def __init__(self, seconds: float, begin: float) -> None:
        self.spoilt = ""
        """Why the mean would mean nothing; empty if it does not."""
        self._begin = begin
        self._end = begin + seconds
        self._parts: list[Values] = []
        self._newest = begin

    @property
    def done(self) -> bool:
        """Whether there is an average."""
        return self._newest >= self._end and bool(self._parts)

    def take(self, values: Values, times: Values) -> None:
        """Take measurements (n, 6) of these times (n,). If none came in time, it begins with the first."""
        first = float(times[0])
        if not self._parts and first > self._end:
            self._begin, self._end = (
                math.nextafter(first, -math.inf),
                first + self._end - self._begin,
            )
        self._newest = float(times[-1])
        wanted = (times > self._begin) & (times <= self._end)
        if wanted.any():
            self._parts.append(values[wanted])

    def result(self) -> Average:
        """Return the average, when it is done."""
        values = np.concatenate(self._parts)
        parts = np.array_split(values, min(PARTS, max(1, len(values) // 2)))
        noise = np.median([part.std(axis=0) for part in parts], axis=0)
        found = values.mean(axis=0), values.std(axis=0), noise
        for each in found:
            each.setflags(write=False)
        return Average(len(values), *found)


def differ(one: Average, other: Average, difference: Values, allowed: Values) -> bool:
    """Whether a difference of two means (6,) is more than their noise and what is `allowed` (6,) besides.

    The noise is that of the quieter one.
    """
    noise = np.minimum(one.noise, other.noise)
    tolerance = SURE * noise / np.sqrt(min(one.count, other.count)) + allowed + 1e-9
    return bool((np.abs(difference) > tolerance).any())
