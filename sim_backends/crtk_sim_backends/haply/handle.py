"""The handle of an Inverse3: a mass with damping in a ball, that motors and a hand push."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

STEP: Final = 0.001
"""Seconds."""
CENTRE: Final = (0.0, -0.12, 0.15)
"""Of the workspace, in m."""
WALL: Final = 2000.0
"""N/m at the end of the workspace."""
WALL_DAMPING: Final = 20.0
"""N·s/m there."""
STIFFNESS: Final = 200.0
"""N/m of the position mode, about critically damped with `POSITION_DAMPING`."""
POSITION_DAMPING: Final = 8.0
STRONGEST: Final = 10.0
"""N that the motors exert at most."""

Triple = tuple[float, float, float]
NONE: Final[Triple] = (0.0, 0.0, 0.0)


class Handle:
    """Where it is and how it moves.

    Args:
        mass: kg.
        damping: N·s/m.
        radius: m of the ball around `CENTRE`.

    Attributes:
        position, velocity: (3,) m, m/s.
        motors: (3,) N that its motors exert.
        hand: (3,) N with which a hand pushes.
        target: (3,) m to which position mode pulls; None: forces.
    """

    def __init__(self, mass: float, damping: float, radius: float) -> None:
        self.position: Triple = CENTRE
        self.velocity: Triple = NONE
        self.motors: Triple = NONE
        self.hand: Triple = NONE
        self.target: Triple | None = None
        self._mass, self._damping, self._radius = mass, damping, radius

    def step(self, duration: float = STEP) -> None:
        """Let so many seconds pass."""
        if self.target is not None:
            self.motors = _bounded(
                STIFFNESS * (goal - here) - POSITION_DAMPING * speed
                for goal, here, speed in zip(self.target, self.position, self.velocity, strict=True)
            )
        away = [here - centre for here, centre in zip(self.position, CENTRE, strict=True)]
        distance = math.hypot(*away)
        beyond = max(0.0, distance - self._radius)
        damping = self._damping + (WALL_DAMPING if beyond else 0.0)
        position, velocity = [], []
        for axis in range(3):
            back = WALL * beyond * away[axis] / distance if beyond else 0.0
            push = self.motors[axis] + self.hand[axis] - back
            rate = damping / self._mass
            # Exact for a force that is constant over the step, so that any damping is stable.
            decay = math.exp(-rate * duration)
            settled = push / damping if damping else 0.0
            speed = self.velocity[axis]
            now = (
                settled + (speed - settled) * decay
                if damping
                else (speed + push / self._mass * duration)
            )
            velocity.append(now)
            position.append(self.position[axis] + 0.5 * (speed + now) * duration)
        self.position = (position[0], position[1], position[2])
        self.velocity = (velocity[0], velocity[1], velocity[2])

    def push(self, force: Triple) -> None:
        """Let the motors exert a force, no greater than they can."""
        self.target, self.motors = None, _bounded(force)

    def let_go(self) -> None:
        """Let the motors exert none."""
        self.target, self.motors = None, NONE

    def put(self, position: Triple) -> None:
        """Be somewhere else, at rest."""
        self.position, self.velocity = position, NONE


def _bounded(values: Iterable[float]) -> Triple:
    x, y, z = (min(max(value, -STRONGEST), STRONGEST) for value in values)
    return x, y, z
