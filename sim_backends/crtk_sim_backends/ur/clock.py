"""Virtual time: it advances by one control period at a time, and only then."""

from __future__ import annotations


class Clock:
    """Time of one controller.

    Attributes:
        dt: control period, s.
        ticks: periods since start.
        time: seconds since start.
    """

    def __init__(self, dt: float) -> None:
        self.dt = dt
        self.ticks = 0
        self.time = 0.0

    def advance(self) -> None:
        """Begin the next control period."""
        self.ticks += 1
        self.time = self.ticks * self.dt
