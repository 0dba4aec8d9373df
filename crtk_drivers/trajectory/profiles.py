"""Point-to-point profiles from any state of motion: time-optimal, jerk-limited, by ruckig.

A new goal while moving begins where the last profile is: position, velocity and acceleration go on without
a jump (`JointProfile.state` gives them, also for the profile that follows).

`JointProfile` moves joints, all of them arriving together. `LineProfile` moves the tool: its position on a
straight line, its orientation on a geodesic, both scaled by one profile of the path. What the tool does when
a line begins is slowed down to rest while the line starts: the first part of the path is then a blend, not
straight. Line and blend have half of the acceleration each, and the line waits as long as it must, so that
they keep the limits together; a line from rest has all of it and waits for nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, Trajectory

from crtk_drivers.device import FULL, CartesianLimits, JointLimits, Ratios
from crtk_drivers.errors import KinematicsError, MotionAborted
from crtk_drivers.geometry.quaternions import (
    matrix_from_quaternion,
    quaternion_from_rotvec,
    quaternion_product,
)
from crtk_drivers.geometry.rates import angular_acceleration, angular_velocity, cross, turn
from crtk_drivers.samples import Pose, Vector, vector
from crtk_drivers.trajectory.interpolators import CARTESIAN_RISE_TIME
from crtk_drivers.trajectory.solver import solve

LINE_SAMPLES = 50
"""At how many points at least a line is checked before it begins."""

LINE_SAMPLE_TIME = 0.02
"""Seconds between two checked points at most, but for lines of more than `MOST_LINE_SAMPLES`."""

MOST_LINE_SAMPLES = 250
"""At how many points at most: one that takes days, by a tiny ratio, is no longer than one of seconds. What
comes next from the same thread, as a stop on ROS, waits for all of them."""

_SHARE_OF_SAMPLE = 0.1
"""Of the time between two checked points, around one of them, over which a speed is told."""

_SPEED_TOLERANCE = 1e-3
"""By how much a joint may exceed its velocity limit on a line: what inverse kinematics leaves open."""

_AT_REST = 1e-9
_WAITS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of a blend that a line may have to wait; after all of it there is nothing to share."""

_BLEND_SAMPLES = 20


class JointProfile:
    """A trajectory from a state of motion to a position at rest.

    Args:
        position, velocity, acceleration: (n,) where it starts, in rad (m) and their derivatives.
        goal: (n,) where it ends.
        limits: one a joint. A start that is faster is slowed down into them first; an acceleration beyond
            them begins at the limit.
        ratios: of the limits; jerk is not scaled.

    Raises:
        MotionAborted: no trajectory within the limits exists.
    """

    def __init__(
        self,
        position: Vector,
        velocity: Vector,
        acceleration: Vector,
        goal: Vector,
        limits: Sequence[JointLimits],
        ratios: Ratios = FULL,
    ) -> None:
        self._goal = vector(goal)
        self._at_rest = vector(np.zeros(self._goal.size))
        most = vector([limit.acceleration for limit in limits])
        # More than the limit would go on until the jerk has ended it: far away, and too fast.
        begin = vector(np.clip(acceleration, -most, most))
        self._trajectory = _trajectory(
            (vector(position), vector(velocity), begin),
            self._goal,
            vector([limit.velocity for limit in limits]) * ratios.velocity,
            most * ratios.acceleration,
            vector([limit.jerk for limit in limits]),
        )

    @property
    def duration(self) -> float:
        """Seconds from start to rest."""
        return float(self._trajectory.duration)

    def at(self, time: float) -> tuple[Vector, Vector]:
        """Return position and velocity (n,) at `time` seconds after the start."""
        position, velocity, _ = self.state(time)
        return position, velocity

    def state(self, time: float) -> tuple[Vector, Vector, Vector]:
        """Return position, velocity and acceleration (n,) at `time` seconds after the start."""
        if time >= self.duration:
            return (
                self._goal,
                self._at_rest,
                self._at_rest,
            )  # ruckig's own end is off by its rounding
        position, velocity, acceleration = self._trajectory.at_time(time)
        return vector(position), vector(velocity), vector(acceleration)


class LineProfile:
    """A straight line of the tool to a pose at rest.

    Args:
        start: where the tool is, in the base frame.
        goal: where it goes, in the same frame. The shorter way round is taken.
        limits: of the tool.
        ratios: of the limits. The acceleration limit is reached in `CARTESIAN_RISE_TIME`.
        twist, acceleration: (6,) what the tool does at the start, linear before angular, base axes.

    Attributes:
        length: m, of the straight line.
        angle: rad, of the geodesic.

    Raises:
        MotionAborted: no trajectory within the limits exists.
    """

    def __init__(
        self,
        start: Pose,
        goal: Pose,
        limits: CartesianLimits,
        ratios: Ratios = FULL,
        twist: Vector | None = None,
        acceleration: Vector | None = None,
    ) -> None:
        still = np.zeros(6)
        moving = still if twist is None else np.asarray(twist)
        speeding = still if acceleration is None else np.asarray(acceleration)
        is_moving = max(abs(moving).max(), abs(speeding).max()) > _AT_REST
        share = ratios.acceleration * (0.5 if is_moving else 1.0)
        self._frame = goal.frame_id
        self._goal = goal
        self._blend = _stopping(moving, speeding, limits, share) if is_moving else None
        self._blended = still
        if self._blend is not None:
            self._blended = np.array(self._blend.at_time(self._blend.duration)[0])
        self._unblended = quaternion_from_rotvec(vector(-self._blended[3:]))
        self._origin = start.position + self._blended[:3]
        self._first = quaternion_product(
            quaternion_from_rotvec(vector(self._blended[3:])), start.orientation
        )
        self._way = goal.position - self._origin
        self._turn = turn(goal.orientation, self._first)
        self.length = float(np.linalg.norm(self._way))
        self.angle = float(np.linalg.norm(self._turn))
        self._path = self._along(limits, ratios.velocity, share)
        self._wait = self._least_wait(limits)

    def _along(self, limits: CartesianLimits, share_v: float, share_a: float) -> Trajectory | None:
        """Return the profile of the path parameter from 0 to 1, or None if there is no way to go."""
        spans = (
            (self.length, limits.linear_velocity, limits.linear_acceleration),
            (self.angle, limits.angular_velocity, limits.angular_acceleration),
        )
        ways = [span for span in spans if span[0] > _AT_REST]
        if not ways:
            return None
        velocity = min(limit / span for span, limit, _ in ways) * share_v
        acceleration = min(limit / span for span, _, limit in ways) * share_a
        zero = np.zeros(1)
        return _trajectory(
            (zero, zero, zero),
            np.ones(1),
            np.array([velocity]),
            np.array([acceleration]),
            np.array([acceleration / CARTESIAN_RISE_TIME]),
        )

    def _least_wait(self, limits: CartesianLimits) -> float:
        """Return after how many seconds the line may begin without exceeding limits with the blend."""
        if self._blend is None or self._path is None:
            return 0.0
        lasts = float(self._blend.duration)
        shares = [index / _BLEND_SAMPLES for index in range(_BLEND_SAMPLES)]
        blend = [self._blend.at_time(lasts * share)[1:] for share in shares]
        most = (
            limits.linear_velocity,
            limits.angular_velocity,
            limits.linear_acceleration,
            limits.angular_acceleration,
        )
        for wait in _WAITS:
            if all(
                self._fits(motion, lasts * (share - wait), most)
                for share, motion in zip(shares, blend, strict=True)
                if share > wait
            ):
                break
        return lasts * wait

    def _fits(self, blend: list[list[float]], time: float, most: tuple[float, ...]) -> bool:
        """Return whether a state of the blend and the line `time` after its start keep limits together."""
        if self._path is None:
            return True
        speed, change = blend
        _, rate, growth = self._path.at_time(time)
        together = (
            math.hypot(*speed[:3]) + self.length * abs(rate[0]),
            math.hypot(*speed[3:]) + self.angle * abs(rate[0]),
            math.hypot(*change[:3]) + self.length * abs(growth[0]),
            math.hypot(*change[3:]) + self.angle * abs(growth[0]),
        )
        return all(value <= limit for value, limit in zip(together, most, strict=True))

    @property
    def duration(self) -> float:
        """Seconds from start to rest."""
        path = 0.0 if self._path is None else self._wait + float(self._path.duration)
        return path if self._blend is None else max(path, float(self._blend.duration))

    def fraction(self, time: float) -> float:
        """Return how much of the way is done, from 0 to 1."""
        return 1.0 if self._path is None else self._parameter(time)[0]

    def at(self, time: float) -> tuple[Pose, Vector]:
        """Return the pose and the twist (6,), linear first, base axes, at `time` after the start."""
        pose, twist, _ = self.state(time)
        return pose, twist

    def state(self, time: float) -> tuple[Pose, Vector, Vector]:
        """Return the pose, the twist (6,) and its derivative (6,) at `time` after the start."""
        if time >= self.duration:
            return self._goal, vector(np.zeros(6)), vector(np.zeros(6))
        done, rate, change = self._parameter(time)
        way = np.concatenate((self._way, self._turn))
        twist, acceleration = way * rate, way * change
        position = self._origin + self._way * done
        orientation = quaternion_product(
            quaternion_from_rotvec(vector(self._turn * done)), self._first
        )
        if self._blend is not None and time < self._blend.duration:
            moved, speed, speeding = (np.array(values) for values in self._blend.at_time(time))
            position = position + moved[:3] - self._blended[:3]
            # On the blend's rotation, which ends as the identity.
            extra = quaternion_product(quaternion_from_rotvec(vector(moved[3:])), self._unblended)
            orientation = quaternion_product(extra, orientation)
            own = angular_velocity(moved[3:], speed[3:])
            carried = matrix_from_quaternion(extra)
            spun = carried @ twist[3:]
            twist = np.concatenate((twist[:3] + speed[:3], spun + own))
            spinning = carried @ acceleration[3:] + cross(own.tolist(), spun.tolist())
            acceleration = np.concatenate(
                (
                    acceleration[:3] + speeding[:3],
                    spinning + angular_acceleration(moved[3:], speed[3:], speeding[3:]),
                )
            )
        return (
            Pose(vector(position), vector(orientation), self._frame),
            vector(twist),
            vector(acceleration),
        )

    def _parameter(self, time: float) -> tuple[float, float, float]:
        time -= self._wait
        if self._path is None or time >= self._path.duration:
            return 1.0, 0.0, 0.0
        if time <= 0.0:
            return 0.0, 0.0, 0.0
        position, velocity, acceleration = self._path.at_time(time)
        return min(1.0, max(0.0, position[0])), velocity[0], acceleration[0]


def check_line(
    line: LineProfile,
    inverse_kinematics: Callable[[Pose, Vector], Vector],
    start: Vector,
    joints: Sequence[str],
    limits: Sequence[JointLimits],
) -> Vector:
    """Go along a line in thought; return the joint position (n,) at its end.

    Args:
        line: to be checked at `LINE_SAMPLES` to `MOST_LINE_SAMPLES` points.
        inverse_kinematics: the joint position nearest to the one given, for a pose.
        start: (n,) where the joints are.
        joints: their names.
        limits: one a joint; range and velocity are checked, the latter also as it grows between two points.

    Raises:
        KinematicsError: it leaves the reach or the range of a joint, or makes a joint too fast, as near a
            singularity; its message says where.
    """
    if line.duration <= 0.0:
        return vector(start)  # it is there already
    wanted = math.ceil(line.duration / LINE_SAMPLE_TIME)
    count = min(max(LINE_SAMPLES, wanted), MOST_LINE_SAMPLES)
    lower = vector([limit.lower for limit in limits])
    upper = vector([limit.upper for limit in limits])
    velocity = vector([limit.velocity for limit in limits])
    here = vector(start)
    step: Vector | None = None
    interval = line.duration / count
    for index in range(1, count + 1):
        time = index * interval
        try:
            following = vector(inverse_kinematics(line.at(time)[0], here))
        except KinematicsError as error:
            raise _broken(line, time, error.message, error.remedy) from error
        outside = (following < lower) | (following > upper)
        if outside.any():
            joint = int(np.argmax(outside))
            raise _broken(
                line,
                time,
                f"{joints[joint]} would be at {following[joint]:.4f}, outside "
                f"[{lower[joint]:.4f}, {upper[joint]:.4f}]",
                "Choose another line, or move_jp.",
            )
        before, step = step, following - here
        fastest = np.abs(step) / interval  # the mean on the way here
        grown = fastest if before is None else np.abs(step + (step - before) / 2.0) / interval
        if (grown > velocity).any():
            # As fast as that if it went on to grow; where the tool has got up to its speed it does not.
            speed = _speed_at(
                line, time, _SHARE_OF_SAMPLE * interval, inverse_kinematics, following
            )
            fastest = np.maximum(fastest, speed)
        excess = fastest / velocity
        joint = int(np.argmax(excess))
        if excess[joint] > 1.0 + _SPEED_TOLERANCE:
            raise _broken(
                line,
                time,
                f"{joints[joint]} would need {fastest[joint]:.3f}, "
                f"more than its {velocity[joint]:.3f} per second",
                "Lower the velocity ratio, stay away from singularities, or use move_jp.",
            )
        here = following
    return here


def _speed_at(
    line: LineProfile,
    time: float,
    around: float,
    inverse_kinematics: Callable[[Pose, Vector], Vector],
    near: Vector,
) -> Vector:
    """Return how fast (n,) the joints are at a point of a line, seen `around` seconds before and after it."""
    try:
        before, after = (
            inverse_kinematics(line.at(time + offset)[0], near) for offset in (-around, around)
        )
    except KinematicsError as error:
        raise _broken(line, time, error.message, error.remedy) from error
    return vector(np.abs(after - before) / (2.0 * around))


def _broken(line: LineProfile, time: float, message: str, remedy: str) -> KinematicsError:
    done = 100.0 * line.fraction(time)
    return KinematicsError(f"the line breaks off after {done:.0f} %: {message}", remedy=remedy)


def _stopping(
    twist: Vector, acceleration: Vector, limits: CartesianLimits, share: float
) -> Trajectory:
    """Return the motion (6,) that ends what the tool does."""
    most = np.repeat((limits.linear_acceleration, limits.angular_acceleration), 3)
    problem = InputParameter(6)
    problem.control_interface = ControlInterface.Velocity
    problem.current_velocity = twist.tolist()
    problem.current_acceleration = np.clip(acceleration, -most, most).tolist()  # see `JointProfile`
    problem.max_acceleration = (most * share / math.sqrt(3.0)).tolist()
    problem.max_jerk = (most / CARTESIAN_RISE_TIME).tolist()
    return _solved(problem, 6)


def _trajectory(
    state: tuple[Vector, Vector, Vector],
    goal: Vector,
    velocity: Vector,
    acceleration: Vector,
    jerk: Vector,
) -> Trajectory:
    size = goal.size
    if not size > 0 or any(part.size != size for part in (*state, velocity)):
        # ruckig would end the process.
        sizes = [part.size for part in state]
        raise MotionAborted(
            f"no trajectory from {sizes} to {size} joints, of {velocity.size}",
            remedy="Does the device report measured_js? Please report this to its author.",
        )
    problem = InputParameter(size)
    problem.current_position = state[0].tolist()
    problem.current_velocity = state[1].tolist()
    problem.current_acceleration = state[2].tolist()
    problem.target_position = goal.tolist()
    problem.max_velocity = velocity.tolist()
    problem.max_acceleration = acceleration.tolist()
    problem.max_jerk = jerk.tolist()
    return _solved(problem, size)


def _solved(problem: InputParameter, size: int) -> Trajectory:
    trajectory = solve(Ruckig(size), problem)
    if trajectory is None:
        raise MotionAborted(
            f"no trajectory to {problem.target_position} within the limits",
            remedy="Check velocity, acceleration and jerk limits in the configuration.",
        )
    return trajectory
