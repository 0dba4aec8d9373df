"""From counts to openings, speeds and forces, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

from crtk_driver_robotiq.registers import COUNTS

__all__ = ["Scale"]


@dataclass(frozen=True, slots=True)
class Scale:
    """Of one gripper.

    Attributes:
        open_count, closed_count: positions that it reads at both ends.
        travel: opening when it is open, in m (rad).
        speeds: in m/s (rad/s) at counts 0 and 255.
    """

    open_count: int
    closed_count: int
    travel: float
    speeds: tuple[float, float]

    @property
    def step(self) -> float:
        """Opening of one count."""
        return self.travel / (self.closed_count - self.open_count)

    def opening(self, count: int) -> float:
        """Return the opening at a position that was read, between 0 and `travel`."""
        return min(max((self.closed_count - count) * self.step, 0.0), self.travel)

    def position(self, opening: float) -> int:
        """Return the count to send for an opening.

        At the ends it is the last count there is: on something thin it presses as on all else.
        """
        if opening <= 0.0:
            return COUNTS
        if opening >= self.travel:
            return 0
        return min(max(round(self.closed_count - opening / self.step), 0), COUNTS)

    def speed(self, speed: float) -> int:
        """Return the count to send for a speed; 0 is the least that there is."""
        slow, fast = self.speeds
        return _share((speed - slow) / (fast - slow))

    def gone(self, speed: int, seconds: float) -> int:
        """Return the counts that fingers go in a time, at a count of the speed: rather more than less."""
        slow, fast = self.speeds
        return math.ceil((slow + speed / COUNTS * (fast - slow)) * seconds / self.step)

    @staticmethod
    def force(share: float) -> int:
        """Return the count to send for a share of the force, 0 to 1."""
        return _share(share)


def _share(value: float) -> int:
    return round(COUNTS * min(max(value, 0.0), 1.0))
