"""Point-to-point profiles for hardware that has no trajectory generator of its own.

Time-optimal, jerk-limited and synchronised, by ruckig.
"""

from __future__ import annotations

from collections.abc import Sequence

from ruckig import InputParameter, Result, Ruckig, RuckigError, Trajectory

from crtk_drivers.device import JointLimits
from crtk_drivers.errors import MotionAborted
from crtk_drivers.samples import Vector, vector


class JointProfile:
    """A trajectory from a joint state to a joint position at rest.

    Args:
        position, velocity: (n,) where the motion starts, in rad (m) and rad/s (m/s).
        goal: (n,) where it ends.
        limits: one a joint.
        ratio: in (0, 1], scales velocity and acceleration.

    Raises:
        MotionAborted: no trajectory within the limits exists.
    """

    def __init__(
        self,
        position: Vector,
        velocity: Vector,
        goal: Vector,
        limits: Sequence[JointLimits],
        ratio: float = 1.0,
    ) -> None:
        if not position.size == velocity.size == goal.size == len(limits) > 0:
            # ruckig would end the process.
            raise MotionAborted(
                f"no trajectory from {position.size} to {goal.size} joints, of {len(limits)}",
                remedy="Does the device report measured_js? Please report this to its author.",
            )
        self._goal = vector(goal)
        self._at_rest = vector([0.0] * goal.size)
        problem = InputParameter(position.size)
        problem.current_position = position.tolist()
        problem.current_velocity = velocity.tolist()
        problem.current_acceleration = [0.0] * position.size
        problem.target_position = goal.tolist()
        problem.target_velocity = [0.0] * position.size
        problem.target_acceleration = [0.0] * position.size
        problem.max_velocity = [limit.velocity * ratio for limit in limits]
        problem.max_acceleration = [limit.acceleration * ratio for limit in limits]
        problem.max_jerk = [limit.jerk for limit in limits]
        self._trajectory = Trajectory(position.size)
        try:
            result = Ruckig(position.size).calculate(problem, self._trajectory)
        except RuckigError as error:
            result, cause = Result.Error, error
        else:
            cause = None
        if result not in (Result.Working, Result.Finished):
            raise MotionAborted(
                f"no trajectory to {goal.tolist()} within the limits ({result})",
                remedy="Check velocity, acceleration and jerk limits in the configuration.",
            ) from cause

    @property
    def duration(self) -> float:
        """Seconds from start to rest."""
        return float(self._trajectory.duration)

    def at(self, time: float) -> tuple[Vector, Vector]:
        """Return position and velocity (n,) at `time` seconds after the start."""
        if time >= self.duration:
            return self._goal, self._at_rest  # ruckig's own end is off by its rounding
        position, velocity, _ = self._trajectory.at_time(time)
        return vector(position), vector(velocity)
