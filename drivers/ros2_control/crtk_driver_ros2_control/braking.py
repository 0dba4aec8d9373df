"""How setpoints come to rest: positions and velocities of joints that slow down. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crtk_drivers.samples import Vector, vector


@dataclass(frozen=True, slots=True, eq=False)
class Braking:
    """Each joint slows down by itself, by its own deceleration.

    Attributes:
        position: where the setpoint was (n,), rad (m).
        velocity: how fast it went (n,), rad/s (m/s).
        deceleration: of each joint (n,), rad/s² (m/s²), above zero.
    """

    position: Vector
    velocity: Vector
    deceleration: Vector

    @property
    def time(self) -> float:
        """Seconds until the last joint stands."""
        return float((np.abs(self.velocity) / self.deceleration).max(initial=0.0))

    def position_at(self, elapsed: float) -> Vector:
        """Return where the setpoint is after so many seconds (n,)."""
        t = np.minimum(elapsed, np.abs(self.velocity) / self.deceleration)
        way = self.velocity * t - 0.5 * np.sign(self.velocity) * self.deceleration * t * t
        return vector(self.position + way)

    def velocity_at(self, elapsed: float) -> Vector:
        """Return how fast it is after so many seconds (n,)."""
        left = np.maximum(np.abs(self.velocity) - self.deceleration * elapsed, 0.0)
        return vector(np.sign(self.velocity) * left)
