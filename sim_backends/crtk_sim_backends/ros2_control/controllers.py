"""Controllers of a simulated robot, as those of ros2_controllers behave."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from typing_extensions import override

from crtk_sim_backends.ros2_control.joints import Vector

FORWARD: Final = "forward_command_controller/ForwardCommandController"
TRAJECTORY: Final = "joint_trajectory_controller/JointTrajectoryController"
BROADCASTER: Final = "joint_state_broadcaster/JointStateBroadcaster"

GOAL_TOLERANCE: Final = 0.02
"""rad."""


class Controller:
    """One controller. Its joints are places in the order of the robot.

    Attributes:
        state: unconfigured, inactive, active, finalized.
        interface: that it commands; empty if it only reads.
        order: its joints, in its own order.
    """

    def __init__(self, name: str, type_name: str, interface: str, order: Sequence[int]) -> None:
        self.name = name
        self.type = type_name
        self.interface = interface
        self.order = list(order)
        self.state = "inactive"

    def activated(self, position: Vector) -> None:
        """It has just become active, where the joints are at `position` (n,)."""

    def deactivated(self) -> None:
        """It has just become inactive."""

    def update(self, now: float, position: Vector) -> Vector | None:
        """Return what it commands (n,), None if nothing."""
        return None


class ForwardController(Controller):
    """Hands each command on, and keeps the last one for ever.

    Args:
        keeps: as old releases do, it still has its last command when it is activated (ros2_control #674), and
            one that came before. Others forget what came while they were inactive.

    Attributes:
        command: the last one, in the order of the robot (n,); None if there was none.
        ignored: commands of another size or with NaN.
    """

    def __init__(self, name: str, interface: str, order: Sequence[int], keeps: bool) -> None:
        super().__init__(name, FORWARD, interface, order)
        self._keeps = keeps
        self.command: Vector | None = None
        self.ignored = 0

    def hear(self, values: Sequence[float]) -> None:
        """A command came, in the order of its joints."""
        if len(values) != len(self.order) or not np.isfinite(values).all():
            self.ignored += 1
            return
        if self.state != "active" and not self._keeps:
            return
        command = np.zeros(len(self.order))
        command[self.order] = values
        self.command = command

    @override
    def activated(self, position: Vector) -> None:
        """See `Controller`."""
        if not self._keeps:
            self.command = None

    @override
    def update(self, now: float, position: Vector) -> Vector | None:
        """See `Controller`."""
        return self.command


@dataclass(frozen=True)
class Point:
    """One point of a trajectory, in the order of the robot (n,)."""

    at: float
    position: Vector
    velocity: Vector | None


class TrajectoryController(Controller):
    """Follows trajectories: linear without velocities, cubic with them. It holds when it is activated.

    Attributes:
        ended: called with whether the goal was reached and why not, once; None if no goal is followed.
    """

    def __init__(self, name: str, order: Sequence[int]) -> None:
        super().__init__(name, TRAJECTORY, "position", order)
        self.ended: Callable[[bool, str], None] | None = None
        self._points: list[Point] = []
        self._began = 0.0
        self._last = np.zeros(len(self.order))

    @override
    def activated(self, position: Vector) -> None:
        """See `Controller`."""
        self._points = []
        self._last = position.copy()

    @override
    def deactivated(self) -> None:
        """End what is followed."""
        self.end(False, "goal cancelled during deactivate transition.")

    def begin(
        self,
        points: Sequence[Point],
        now: float,
        position: Vector,
        velocity: Vector,
        ended: Callable[[bool, str], None] | None = None,
    ) -> None:
        """Follow points from now on, from where the joints are; what was followed before is given up."""
        self.end(False, "replaced by another trajectory")
        self._points = [Point(0.0, self._last.copy(), velocity.copy()), *points]
        self._began = now
        self.ended = ended

    def hold(self, why: str) -> None:
        """Follow nothing any more."""
        self._points = []
        self.end(False, why)

    def end(self, reached: bool, why: str) -> None:
        """Tell of the end of a goal, if there is one."""
        ended, self.ended = self.ended, None
        if ended is not None:
            ended(reached, why)

    @override
    def update(self, now: float, position: Vector) -> Vector | None:
        """See `Controller`."""
        if self._points:
            at = now - self._began
            self._last = _sampled(self._points, at)
            if at >= self._points[-1].at and self.ended is not None:
                away = np.abs(position - self._points[-1].position).max()
                if away < GOAL_TOLERANCE:
                    self.end(True, "Goal successfully reached!")
        return self._last


def _sampled(points: Sequence[Point], at: float) -> Vector:
    for a, b in pairwise(points):
        if at < b.at:
            span = b.at - a.at
            t = max(0.0, (at - a.at) / span)
            if b.velocity is None or a.velocity is None:
                return a.position + t * (b.position - a.position)
            h00, h10 = 2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t
            h01, h11 = -2 * t**3 + 3 * t**2, t**3 - t**2
            return (
                h00 * a.position
                + h10 * span * a.velocity
                + h01 * b.position
                + h11 * span * b.velocity
            )
    return points[-1].position
