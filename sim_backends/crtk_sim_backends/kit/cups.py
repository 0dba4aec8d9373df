"""Cups at a pump and what lies under them: the mechanics that simulated suction tools have in common."""

from __future__ import annotations

import math

__all__ = ["Cups"]


class Cups:
    """Those of one channel; no clock.

    Attributes:
        vacuum: below the surroundings, in Pa.
        leak: of what lies under them: rate in 1/s at which air comes in; None: nothing lies there.
    """

    def __init__(self, leak: float | None = 0.0) -> None:
        self.vacuum = 0.0
        self.leak = leak

    def flow(
        self, seconds: float, *, deepest: float, pump: float, vent: float, is_open: float
    ) -> None:
        """Let air flow for a while.

        Args:
            seconds: how long.
            deepest: vacuum that the pump comes to when nothing leaks, in Pa.
            pump: rate in 1/s at which it comes there; 0: it rests.
            vent: rate in 1/s at which a valve lets air in; 0: it is closed.
            is_open: rate in 1/s at which air comes into cups under which nothing lies.
        """
        air = vent + (is_open if self.leak is None else self.leak)
        total = pump + air
        if total:
            rest = pump * deepest / total
            self.vacuum = rest + (self.vacuum - rest) * math.exp(-total * seconds)
