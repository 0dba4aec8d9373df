"""How fast a joint may be that has to stop before the end of its range."""

from __future__ import annotations

import math

NEGLIGIBLE = 1e-6
"""Share of its velocity limit below which a joint takes no part in the motion of the tool: Jacobians are
rounded, and one joint that is at the end of its range must not stop the others by that."""


def stoppable_speed(room: float, deceleration: float, delay: float) -> float:
    """Return the speed towards a limit from which a joint still stops before it.

    Args:
        room: rad (m) to the limit; beyond it, nothing is stoppable.
        deceleration: rad/s² (m/s²) that the joint brakes with.
        delay: seconds for which it goes on before it brakes.
    """
    if not room > 0.0:
        return 0.0
    if math.isinf(room):
        return math.inf
    braking = math.sqrt(2.0 / deceleration) * math.sqrt(room)  # seconds, if it began at once
    return room / (0.5 * (delay + math.hypot(delay, braking)))


def braking_way(speed: float, deceleration: float, delay: float) -> float:
    """Return how far a joint goes that is stopped from `speed`; the inverse of `stoppable_speed`."""
    return speed * delay + speed * speed / (2.0 * deceleration)
