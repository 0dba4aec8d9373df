"""Velocity ramps and positioning profiles, computed one control period after the other."""

from __future__ import annotations

import math
from typing import Final

COUNTER: Final = float(2**32)
"""Counts after which a counter of 32 bits begins anew."""


def over_the_end(count: float) -> float:
    """Return what a counter of 32 bits with a sign leaves out of so many counts: a multiple of `COUNTER`."""
    return COUNTER * math.floor((count + COUNTER / 2) / COUNTER)


def approach(value: float, target: float, change: float) -> float:
    """Move `value` towards `target` by at most `change`."""
    if abs(target - value) <= change:
        return target
    return value + math.copysign(change, target - value)


def ramp_velocity(velocity: float, target: float, up: float, down: float, dt: float) -> float:
    """Change a velocity towards a target: `up` away from zero, `down` towards it (units/s²)."""
    slowing = velocity * target < 0 or abs(target) < abs(velocity)
    if not slowing:
        return approach(velocity, target, up * dt)
    if velocity * target < 0:
        return approach(velocity, 0.0, down * dt)
    return approach(velocity, target, down * dt)


def toward(
    position: float,
    velocity: float,
    target: float,
    speed: float,
    up: float,
    down: float,
    dt: float,
    *,
    stop: bool = True,
) -> tuple[float, float]:
    """One step of a trapezoidal profile.

    Args:
        position: present setpoint.
        velocity: its velocity.
        target: where it goes.
        speed: greatest speed, units/s.
        up: acceleration, units/s².
        down: deceleration, units/s².
        dt: length of the step, s.
        stop: come to rest at the target; otherwise pass it.

    Returns:
        Position and velocity after the step; exactly the target and 0 at the end.
    """
    distance = target - position
    wanted = speed
    if stop:
        # greatest velocity from which whole steps of `down` end at the target
        per_step = down * dt
        wanted = min(
            speed, per_step * (math.sqrt(0.25 + 2 * abs(distance) / (per_step * dt)) - 0.5)
        )
    new = ramp_velocity(velocity, math.copysign(wanted, distance), up, down, dt)
    ends = abs(distance) <= abs(new) * dt or abs(distance) < 1e-9
    if stop and ends and abs(new) <= 2 * down * dt and new * distance >= 0:
        return target, 0.0
    return position + new * dt, new


def cubic(
    share: float, begin: float, end: float, begin_rate: float, end_rate: float, seconds: float
) -> float:
    """Return where a cubic curve between two points with velocity is, after a share (0 to 1) of its time.

    Args:
        share: of its time.
        begin, end: positions.
        begin_rate, end_rate: velocities, units/s.
        seconds: from one to the other.
    """
    h10 = share**3 - 2.0 * share**2 + share
    h01 = 3.0 * share**2 - 2.0 * share**3
    h11 = share**3 - share**2
    return begin + (end - begin) * h01 + seconds * (begin_rate * h10 + end_rate * h11)
