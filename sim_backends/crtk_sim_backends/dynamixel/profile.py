"""The trajectory that a servo makes of a goal: step, rectangle, triangle or trapezoid, in closed form.

Source: e-manual, X series, "Profile" (Profile Acceleration 108, Profile Velocity 112, Moving Status 123).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

STEP: Final = 0x00
RECTANGLE: Final = 0x10
TRIANGLE: Final = 0x20
TRAPEZOID: Final = 0x30
"""Bits 4 and 5 of Moving Status."""


class Profile(NamedTuple):
    """Up to three phases of constant acceleration: (duration s, acceleration rad/s²) each.

    Attributes:
        start: rad, where it begins.
        velocity: rad/s, with which it begins.
        goal: rad, where it ends.
        kind: see the bits above.
    """

    start: float
    velocity: float
    goal: float
    kind: int
    phases: tuple[tuple[float, float, float], ...]  # duration, velocity at its begin, acceleration
    duration: float

    def at(self, time: float) -> tuple[float, float, float]:
        """Position, velocity and acceleration `time` seconds after the beginning."""
        if time >= self.duration:
            return self.goal, 0.0, 0.0
        position = self.start
        for duration, velocity, acceleration in self.phases:
            if time <= duration:
                return (
                    position + velocity * time + 0.5 * acceleration * time * time,
                    velocity + acceleration * time,
                    acceleration,
                )
            position += velocity * duration + 0.5 * acceleration * duration * duration
            time -= duration
        return self.goal, 0.0, 0.0


def rest(position: float) -> Profile:
    """Stand still."""
    return Profile(position, 0.0, position, STEP, (), 0.0)


def by_velocity(
    start: float, velocity: float, goal: float, limit: float, acceleration: float
) -> Profile:
    """Velocity-based: cruise at `limit` rad/s (0: there at once), `acceleration` in rad/s² (0: infinite)."""
    if limit <= 0.0 or (goal == start and velocity == 0.0):
        return Profile(goal, 0.0, goal, STEP, (), 0.0)
    if acceleration <= 0.0:
        duration = abs(goal - start) / limit
        cruise = math.copysign(limit, goal - start)
        return Profile(start, cruise, goal, RECTANGLE, ((duration, cruise, 0.0),), duration)
    stopped = start + 0.5 * velocity * abs(velocity) / acceleration
    way = math.copysign(1.0, goal - stopped)
    first = way * velocity
    distance = way * (goal - start)
    peak = math.sqrt(max(0.0, acceleration * distance + 0.5 * first * first))
    cruise = min(peak, limit)
    change = math.copysign(acceleration, cruise - first)
    times = [abs(cruise - first) / acceleration, 0.0, cruise / acceleration]
    if peak > limit:
        covered = 0.5 * (first + cruise) * times[0] + 0.5 * cruise * times[2]
        times[1] = max(0.0, distance - covered) / cruise
    phases = (
        (times[0], velocity, way * change),
        (times[1], way * cruise, 0.0),
        (times[2], way * cruise, -way * acceleration),
    )
    kind = TRAPEZOID if times[1] > 0.0 else TRIANGLE
    return Profile(start, velocity, goal, kind, phases, sum(times))


def by_time(
    start: float, velocity: float, goal: float, duration: float, acceleration: float
) -> Profile:
    """Time-based profile: takes `duration` s (0: at once there), of which it accelerates `acceleration` s."""
    if duration <= 0.0:
        return by_velocity(start, velocity, goal, 0.0, 0.0)
    ramp = min(acceleration, duration / 2.0)
    cruise = abs(goal - start) / (duration - ramp)
    return by_velocity(start, velocity, goal, cruise, cruise / ramp if ramp > 0.0 else 0.0)
