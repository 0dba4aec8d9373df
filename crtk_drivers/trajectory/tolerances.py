"""How far joints may be from a trajectory, by the rules of joint_trajectory_controller.

Of each value that a goal gives (ros2_controllers, tolerances.hpp, ``resolve_tolerance_source``): 0, or
nothing at all, leaves the default; -1 erases it, so that there is no limit; another negative one is illegal
and leaves the default.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from crtk_drivers.samples import JointState, Tolerance, Vector

UNLIMITED = math.inf
_ERASED = -1.0


def resolved(asked: float, default: float) -> float:
    """Return the limit in force for a value that a goal gives."""
    if asked > 0.0:
        return asked
    return UNLIMITED if asked == _ERASED else default


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits in force for some joints; `UNLIMITED` where there is none.

    Attributes:
        joints: names.
        position: one for each, rad (m).
        velocity: one for each, rad/s (m/s).
    """

    joints: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]

    def violated(self, desired: JointState, actual: JointState) -> str:
        """Return which joint is too far from what is desired, in words; empty if none is.

        What is not measured is not judged.
        """
        for what, limits, wanted, is_ in (
            ("position", self.position, desired.position, actual.position),
            ("velocity", self.velocity, desired.velocity, actual.velocity),
        ):
            if is_.size == wanted.size == len(limits):
                text = self._worst(what, limits, wanted, is_)
                if text:
                    return text
        return ""

    def _worst(self, what: str, limits: Sequence[float], wanted: Vector, is_: Vector) -> str:
        for name, limit, goal, value in zip(
            self.joints, limits, wanted.tolist(), is_.tolist(), strict=True
        ):
            if not abs(goal - value) <= limit:
                return (
                    f"the {what} of {name} is {value:.4f}, {abs(goal - value):.4f} from {goal:.4f} "
                    f"(at most {limit:g})"
                )
        return ""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """What is in force while a trajectory is gone along.

    Attributes:
        path: on the way.
        goal: at its end.
        goal_time: seconds that it may take longer until it is there; 0: as long as it takes.
    """

    path: Limits
    goal: Limits
    goal_time: float = 0.0


def limits_of(
    joints: tuple[str, ...],
    asked: Sequence[Tolerance],
    position: Sequence[float],
    velocity: Sequence[float],
) -> Limits:
    """Return the limits in force.

    Args:
        joints: names, in the order of the device.
        asked: by the goal, of some of them.
        position, velocity: the defaults, one for each joint.
    """
    of: Mapping[str, Tolerance] = {each.name: each for each in asked}
    none = Tolerance("")
    return Limits(
        joints,
        tuple(
            resolved(of.get(name, none).position, default)
            for name, default in zip(joints, position, strict=True)
        ),
        tuple(
            resolved(of.get(name, none).velocity, default)
            for name, default in zip(joints, velocity, strict=True)
        ),
    )
