"""How long joints take to come to rest."""

from __future__ import annotations

from typing import Final

from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.modes import Way

__all__ = ["braking_time"]

COASTING: Final = 4.0
"""Seconds for joints to come to rest by friction alone."""
GRACE: Final = 0.25
"""Seconds beyond the time that a joint needs to slow down, after which it does not stop as it was told."""


def braking_time(config: CanopenConfig) -> float:
    """Return the seconds in which the slowest joint comes to rest from its greatest velocity.

    Joints that take nothing but efforts have no torque when they are told to stop, and coast.
    """
    if config.ways[:1] == (Way.EFFORTS,):
        return COASTING
    joints = config.joints.values()
    slowest = max((joint.velocity / joint.acceleration for joint in joints), default=0.0)
    return slowest + GRACE
