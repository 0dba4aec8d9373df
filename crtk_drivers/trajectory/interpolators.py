"""Interpolators of joints, twists, wrenches and poses; `crtk_drivers.trajectory.smoothing` has the method."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from ruckig import Synchronization
from typing_extensions import override

from crtk_drivers.commands import Kind
from crtk_drivers.device import CartesianLimits, JointLimits
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, quaternion_product, unit
from crtk_drivers.geometry.rates import angular_acceleration, angular_velocity, turn
from crtk_drivers.samples import JointState, Pose, Twist, Vector, Wrench, joint_state, vector
from crtk_drivers.trajectory.smoothing import Interpolator, Rates

CARTESIAN_RISE_TIME = 0.1
"""Seconds in which the tool reaches its acceleration limit: Cartesian limits have no jerk."""

EFFORT_RISE_TIME = 0.1
"""Seconds in which an effort, force or torque may go from zero to its limit."""

_DIFFERENT = 1e-9
"""What goes out differs from what was asked for by more than rounding."""


class VectorInterpolator(Interpolator[Vector]):
    """A stream of n numbers, each with limits of its own.

    Call `start` with the present setpoint, then `command` for each goal and `step` in each cycle.
    """

    def start(
        self,
        value: ArrayLike,
        now: float,
        rate: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
    ) -> None:
        """Begin at the present setpoint: value (n,), its first and its second derivative.

        Raises:
            ValueError: not n finite numbers.
        """
        size = self._rates.velocity.size
        zeros = np.zeros(size)
        self._value = _finite(value, size)
        self._rate = zeros if rate is None else _finite(rate, size)
        self._acceleration = zeros if acceleration is None else _finite(acceleration, size)
        self._lower = np.minimum(self._rates.lower, self._value)
        self._upper = np.maximum(self._rates.upper, self._value)
        self._begin(self._value, now)

    def command(self, goal: ArrayLike, now: float) -> None:
        """A goal (n,) arrived at `now`. It is clipped to its range.

        Raises:
            ValueError: not n finite numbers; nothing is changed.
        """
        target = np.clip(_finite(goal, self._rates.velocity.size), self._lower, self._upper)
        self._accept(target, np.array_equal(target, self.goal), now)

    def step(self, now: float) -> tuple[Vector, Vector]:
        """Return the setpoint (n,) and its derivative at `now`."""
        self._advance(now)
        return vector(self._value), vector(self._rate)

    def held_at(self, value: Vector) -> None:
        """Go on from a value (n,) that went out in place of that of the last step; there, at rest."""
        held = np.abs(value - self._value) > _DIFFERENT
        if not held.any():
            return
        self._value = vector(np.where(held, value, self._value))
        self._rate = vector(np.where(held, 0.0, self._rate))
        self._acceleration = vector(np.where(held, 0.0, self._acceleration))
        self._plan(max(0.0, self._run - self._elapsed))

    @property
    def goal(self) -> Vector:
        """The newest goal (n,)."""
        return self._goals.newest[1]

    @property
    def rate(self) -> Vector:
        """The first derivative (n,) of the present setpoint."""
        return self._rate

    @property
    def acceleration(self) -> Vector:
        """The second derivative (n,) of the present setpoint."""
        return self._acceleration

    @override
    def _read(self, position: Vector, velocity: Vector, acceleration: Vector) -> None:
        outside = (position < self._lower) | (position > self._upper)
        if outside.any():
            position = np.clip(position, self._lower, self._upper)
        self._value, self._rate, self._acceleration = position, velocity, acceleration

    @override
    def _problem(self) -> tuple[Vector, Vector, Vector, Vector, Vector]:
        (after, goal), (before, base) = self._goals.newest, self._goals.base
        slope = (goal - base) / max(after - before, self._cycle)
        return self._value, self._rate, self._acceleration, goal, slope

    @override
    def _zero(self) -> Vector:
        return np.clip(np.zeros(self._value.size), self._lower, self._upper)


class JointInterpolator(VectorInterpolator):
    """interpolate_jp and _jr (kind POSITION), interpolate_jv (VELOCITY) or interpolate_jf (EFFORT).

    Positions keep the limits of range, velocity, acceleration and jerk. Velocities keep those of
    velocity, acceleration and jerk. An effort goes from zero to its limit in `EFFORT_RISE_TIME`.

    Args:
        limits: one for each joint.
        cycle: seconds between two steps.
        stream_timeout: seconds without a goal after which the stream is over.
        kind: what the goals are.
    """

    def __init__(
        self,
        limits: Sequence[JointLimits],
        cycle: float,
        stream_timeout: float,
        kind: Kind = Kind.POSITION,
    ) -> None:
        super().__init__(
            _joint_rates(limits, kind),
            cycle,
            stream_timeout,
            rests_at_goal=kind in (Kind.POSITION, Kind.RELATIVE),
        )
        self._kind = kind

    def point(self, now: float) -> JointState:
        """Take a step, and return position and velocity, or velocity, or effort, by `kind`."""
        value, rate = self.step(now)
        if self._kind in (Kind.POSITION, Kind.RELATIVE):
            return JointState(position=value, velocity=rate)
        return joint_state(self._kind, value)


class TwistInterpolator(VectorInterpolator):
    """interpolate_cv: goals are six numbers, linear (m/s) before angular (rad/s), in fixed axes.

    Each axis keeps 1/√3 of the accelerations, so that their norms are kept; it takes
    `CARTESIAN_RISE_TIME` to reach them. It ends at zero.
    """

    def __init__(self, limits: CartesianLimits, cycle: float, stream_timeout: float) -> None:
        velocity = _halves(limits.linear_velocity, limits.angular_velocity)
        acceleration = _halves(limits.linear_acceleration, limits.angular_acceleration)
        acceleration = vector(acceleration / math.sqrt(3.0))
        rates = Rates(
            acceleration,
            vector(acceleration / CARTESIAN_RISE_TIME),
            vector([math.inf] * 6),
            vector(-velocity),
            velocity,
        )
        super().__init__(rates, cycle, stream_timeout, rests_at_goal=False)

    def point(self, now: float) -> Twist:
        """Take a step, and return the twist."""
        value, _ = self.step(now)
        return Twist(vector(value[:3]), vector(value[3:]))


class WrenchInterpolator(VectorInterpolator):
    """interpolate_cf: goals are six numbers, force (N) before torque (N·m), in fixed axes; ends at zero."""

    def __init__(self, limits: CartesianLimits, cycle: float, stream_timeout: float) -> None:
        rates = _effort_rates(_halves(limits.force, limits.torque))
        super().__init__(rates, cycle, stream_timeout, rests_at_goal=False)

    def point(self, now: float) -> Wrench:
        """Take a step, and return the wrench."""
        value, _ = self.step(now)
        return Wrench(vector(value[:3]), vector(value[3:]))


class PoseInterpolator(Interpolator[tuple[Vector, Vector]]):
    """interpolate_cp and interpolate_cr: position in a straight line, orientation on a geodesic.

    The orientation is planned as the rotation vector from the setpoint of the moment, in base axes. Goals
    may not turn by more than pi within one latency, or the shorter way round is taken. Each axis keeps
    1/√3 of the limits, so that their norms are kept (a turn about a changing axis: to the first order in
    its angle within one period); the tool takes `CARTESIAN_RISE_TIME` to reach an acceleration limit.
    """

    def __init__(self, limits: CartesianLimits, cycle: float, stream_timeout: float) -> None:
        velocity = _halves(limits.linear_velocity, limits.angular_velocity) / math.sqrt(3.0)
        acceleration = _halves(limits.linear_acceleration, limits.angular_acceleration)
        acceleration = acceleration / math.sqrt(3.0)
        far = vector([math.inf] * 6)
        rates = Rates(
            vector(velocity),
            vector(acceleration),
            vector(acceleration / CARTESIAN_RISE_TIME),
            vector(-far),
            far,
        )
        super().__init__(rates, cycle, stream_timeout, Synchronization.Phase)

    def start(
        self,
        pose: Pose,
        now: float,
        twist: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
    ) -> None:
        """Begin at the present setpoint: pose, twist (6,) and its derivative, linear first, base axes.

        Raises:
            ValueError: not finite numbers of these sizes.
        """
        zeros = np.zeros(6)
        self._position, self._orientation = _finite_pose(pose)
        self._frame = pose.frame_id
        self._twist = zeros if twist is None else _finite(twist, 6)
        self._acceleration = zeros if acceleration is None else _finite(acceleration, 6)
        self._centre = self._orientation
        self._begin((self._position, self._orientation), now)

    def command(self, goal: Pose, now: float) -> None:
        """A goal arrived at `now`.

        Raises:
            ValueError: not finite; nothing is changed.
        """
        position, orientation = _finite_pose(goal)
        newest = self._goals.newest[1]
        is_repeated = np.array_equal(position, newest[0]) and np.array_equal(orientation, newest[1])
        self._accept((position, orientation), is_repeated, now)

    def step(self, now: float) -> tuple[Pose, Twist]:
        """Return the pose and the twist (base axes) at `now`."""
        self._advance(now)
        pose = Pose(vector(self._position), self._orientation, self._frame)
        return pose, Twist(vector(self._twist[:3]), vector(self._twist[3:]), self._frame)

    point = step

    @property
    def goal(self) -> Pose:
        """The newest goal."""
        position, orientation = self._goals.newest[1]
        return Pose(vector(position), orientation, self._frame)

    @property
    def acceleration(self) -> Vector:
        """Linear (m/s²) and angular acceleration (rad/s²) (6,) of the present setpoint."""
        return self._acceleration

    @override
    def _read(self, position: Vector, velocity: Vector, acceleration: Vector) -> None:
        self._position = position[:3]
        away = position[3:]
        turned = quaternion_product(quaternion_from_rotvec(away), self._centre)
        self._orientation = unit(turned)
        self._twist = np.concatenate((velocity[:3], angular_velocity(away, velocity[3:])))
        spin = angular_acceleration(away, velocity[3:], acceleration[3:])
        self._acceleration = np.concatenate((acceleration[:3], spin))

    @override
    def _problem(self) -> tuple[Vector, Vector, Vector, Vector, Vector]:
        self._centre = self._orientation
        (after, goal), (before, base) = self._goals.newest, self._goals.base
        position = np.concatenate((self._position, np.zeros(3)))
        target = np.concatenate((goal[0], turn(goal[1], self._centre)))
        moved = np.concatenate((goal[0] - base[0], turn(goal[1], base[1])))
        slope = moved / max(after - before, self._cycle)
        return position, self._twist, self._acceleration, target, slope

    @override
    def _zero(self) -> tuple[Vector, Vector]:
        return self._goals.newest[1]  # never asked for: a pose rests at its goal


def _finite(values: ArrayLike, size: int) -> Vector:
    array = vector(values)
    if array.size != size or not np.isfinite(array).all():
        raise ValueError(f"expected {size} finite numbers, got {array.tolist()}")
    return array


def _finite_pose(pose: Pose) -> tuple[Vector, Vector]:
    position, orientation = _finite(pose.position, 3), _finite(pose.orientation, 4)
    norm = math.sqrt(float(orientation @ orientation))
    if not norm > 0.0:
        raise ValueError("the quaternion is zero")
    return position, vector(orientation / norm)


def _halves(first: float, second: float) -> Vector:
    return vector([first] * 3 + [second] * 3)


def _effort_rates(limit: Vector) -> Rates:
    rise = np.maximum(limit, 1e-9) / EFFORT_RISE_TIME
    return Rates(
        vector(rise),
        vector(rise / EFFORT_RISE_TIME * 2.0),
        vector([math.inf] * limit.size),
        vector(-limit),
        limit,
    )


def _joint_rates(limits: Sequence[JointLimits], kind: Kind) -> Rates:
    velocity = vector([limit.velocity for limit in limits])
    acceleration = vector([limit.acceleration for limit in limits])
    jerk = vector([limit.jerk for limit in limits])
    if kind is Kind.EFFORT:
        return _effort_rates(vector([limit.effort for limit in limits]))
    if kind is Kind.VELOCITY:
        none = vector([math.inf] * len(limits))
        return Rates(acceleration, jerk, none, vector(-velocity), velocity)
    return Rates(
        velocity,
        acceleration,
        jerk,
        vector([limit.lower for limit in limits]),
        vector([limit.upper for limit in limits]),
    )
