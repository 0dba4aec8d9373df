"""Whether a setpoint has arrived at the goal of a move."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from crtk_drivers.samples import JointState, Pose, Value

if TYPE_CHECKING:
    from crtk_drivers.client.inbox import Inbox

JOINT_TOLERANCE = 1e-3
"""Radians or metres by which the setpoint at the end of a move may differ from its goal."""
LINEAR_TOLERANCE = 1e-3
ANGULAR_TOLERANCE = 5e-3


def goal_test(setpoint: Inbox | None, goal: Value | None) -> Callable[[], bool | None]:
    """Return what tells whether the setpoint is at `goal`, and None as long as that cannot be told."""

    def at_goal() -> bool | None:
        latest = None if setpoint is None else setpoint.readable()
        if latest is None or latest.wall_ns == 0 or goal is None:
            return None
        return _near(latest.value, goal)

    return at_goal


def _near(setpoint: Value, goal: Value) -> bool | None:
    if isinstance(setpoint, Pose) and isinstance(goal, Pose):
        distance = float(np.linalg.norm(setpoint.position - goal.position))
        cosine = min(1.0, abs(float(setpoint.orientation @ goal.orientation)))
        angle = 2.0 * float(np.arccos(cosine))
        return distance <= LINEAR_TOLERANCE and angle <= ANGULAR_TOLERANCE
    if not (isinstance(setpoint, JointState) and isinstance(goal, JointState)):
        return None
    wanted = goal.position
    if goal.name and setpoint.name:
        if set(goal.name) != set(setpoint.name):
            return None
        wanted = wanted[[goal.name.index(name) for name in setpoint.name]]
    if setpoint.position.size != wanted.size or not wanted.size:
        return None
    return bool(np.max(np.abs(setpoint.position - wanted)) <= JOINT_TOLERANCE)
