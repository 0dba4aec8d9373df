"""The mechanics of a simulated robot: joints that follow positions, velocities or efforts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

STEP: Final = 0.002
"""Longest step of the integration, s."""
GAIN: Final = 40.0
"""Of the position servo, 1/s: of its lag of 25 ms."""
STIFF: Final = 200.0
"""Of the velocity loop, 1/s."""
DAMPING: Final = 4.0
"""N·m·s/rad, of a joint that takes efforts."""
INERTIA: Final = 1.0
"""kg·m²."""


@dataclass(frozen=True)
class JointLimits:
    """Of one joint, in rad, rad/s, rad/s² and N·m."""

    name: str
    lower: float = -3.0
    upper: float = 3.0
    velocity: float = 1.5
    acceleration: float = 8.0
    effort: float = 40.0


class Joints:
    """All joints of a robot.

    Attributes:
        position, velocity, effort: of each joint (n,).
        kind: of the commands that they follow: position, velocity, effort; empty: they hold.
        command: the last one (n,).
        blocked: places of joints that something holds.
    """

    def __init__(self, limits: tuple[JointLimits, ...], start: Vector) -> None:
        count = len(limits)
        self.position = start.copy()
        self.velocity = np.zeros(count)
        self.effort = np.zeros(count)
        self.kind = ""
        self.command = start.copy()
        self.blocked: set[int] = set()
        self._lower = np.array([limit.lower for limit in limits])
        self._upper = np.array([limit.upper for limit in limits])
        self._fastest = np.array([limit.velocity for limit in limits])
        self._most = np.array([limit.effort for limit in limits])

    def use(self, kind: str) -> None:
        """Follow commands of another kind, which begin as the joints are now; the same goes on."""
        if kind == self.kind:
            return
        self.kind = kind
        if kind in ("", "position"):
            self.command = self.position.copy()
        else:
            self.command = np.zeros_like(self.position)

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        while seconds > 0.0:
            step = min(seconds, STEP)
            self._step(step)
            seconds -= step

    def _step(self, step: float) -> None:
        before = self.velocity
        if self.kind == "effort":
            push = np.clip(self.command, -self._most, self._most)
            self.velocity = before + step * (push - DAMPING * before) / INERTIA
        else:
            wanted = self.command
            if self.kind != "velocity":
                wanted = GAIN * (self.command - self.position)
            wanted = np.clip(wanted, -1.2 * self._fastest, 1.2 * self._fastest)
            self.velocity = before + (wanted - before) * min(1.0, STIFF * step)
        for place in self.blocked:
            self.velocity[place] = 0.0
        moved = self.position + step * self.velocity
        self.position = np.clip(moved, self._lower, self._upper)
        self.velocity = np.where(self.position == moved, self.velocity, 0.0)
        self.effort = INERTIA * (self.velocity - before) / step + DAMPING * self.velocity
