"""The mean of measurements over a while, taken while the I/O thread goes on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crtk_drivers.samples import Array, Vector, vector


@dataclass(frozen=True, eq=False)
class Average:
    """Of `count` measurements (6,): their mean and their standard deviation."""

    count: int
    mean: Vector
    deviation: Vector


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
        self._parts: list[Array] = []
        self._newest = begin

    @property
    def done(self) -> bool:
        """Whether there is an average."""
        return self._newest >= self._end and bool(self._parts)

    def take(self, values: Array, times: Vector) -> None:
        """Take measurements (n, 6) of these times (n,)."""
        self._newest = float(times[-1])
        wanted = (times > self._begin) & (times <= self._end)
        if wanted.any():
            self._parts.append(values[wanted])

    def result(self) -> Average:
        """Return the average, when it is done."""
        values = np.concatenate(self._parts)
        return Average(len(values), vector(values.mean(axis=0)), vector(values.std(axis=0)))
