"""servo_js and servo_cs whose axes follow values of different kinds, in the I/O thread.

Axes of position go to the newest position, axes of velocity move on from where they are, the others come to
rest. All are carried out as positions. When no command comes for the timeout, the axes of velocity slow down
and the stream is over.
"""

from __future__ import annotations

import math

import numpy as np
from typing_extensions import override

from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.gates.resolved_rate import ResolvedRate
from crtk_drivers.geometry.frames import product, relative, twist_from_base, twist_in_base
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, quaternion_product, unit
from crtk_drivers.motion.arbiter import Order
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.point import Point
from crtk_drivers.motion.streams import ServoStream
from crtk_drivers.motion.tool import Pursuit
from crtk_drivers.samples import (
    AxisMode,
    CartesianServo,
    JointServo,
    Pose,
    Vector,
    empty,
    vector,
)

_STILL = 1e-6
"""rad/s (m/s) of an axis that stands."""


class MixedJointStream(ServoStream):
    """servo_js with axes of position and of velocity."""

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name, context, now)
        self._rates = ResolvedRate(context.capabilities.limits, None, self._cycle)
        position, self._velocity, _ = self._feedback.motion(now)
        self._position = position
        self._wanted = vector(np.zeros(position.size))
        self._moves = np.zeros(position.size, dtype=bool)
        self._begins = True

    @override
    def feed(self, order: Order, now: float) -> None:
        assert isinstance(order.target, JointServo)
        value, modes = order.target, np.array(order.target.modes)
        here = position = self._feedback.reference_joints()
        goes, moves = modes == AxisMode.POSITION, modes == AxisMode.VELOCITY
        if goes.any():
            position = vector(np.where(goes, value.position, here))
            limiter = self._context.limiter
            if self._begins:
                limiter.check_start(self.name, position, here, self._velocity)
            limiter.check_speed(self.name, position, here, now)
        self._begins = False
        self._position, self._moves = position, ~goes
        self._wanted = value.velocity if moves.any() else vector(np.zeros(here.size))
        self._silence.feed(now)

    @override
    def point(self, now: float) -> Point:
        if self._fell_silent(now):
            self._wanted = vector(np.zeros(self._wanted.size))
        here = self._feedback.reference_joints()
        before = vector(np.where(self._moves, self._velocity, 0.0))
        self._velocity = self._rates.limited(here, self._wanted, before)
        moved = here + self._velocity * self._cycle
        return Point(
            Setpoint(Mode.JOINT_POSITION, vector(np.where(self._moves, moved, self._position)))
        )

    @property
    @override
    def is_over(self) -> bool:
        return super().is_over and bool(np.abs(self._velocity).max() <= _STILL)


class MixedAxesStream(ServoStream):
    """servo_cs with axes of position and of velocity, in a task frame."""

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name, context, now)
        self._pursuit = Pursuit(context)
        self._takes_poses = Mode.CARTESIAN_POSITION in context.capabilities.modes
        self._task = self._inverse.pose(self._command)
        self._held: Pose | None = None
        twist = twist_from_base(self._feedback.reference_twist(now), "body", self._task)
        self._twist: list[float] = twist.tolist()
        self._wanted = [0.0] * 6
        self._has_position = False
        limits = context.capabilities.cartesian_limits
        assert limits is not None
        most = (limits.linear_acceleration,) * 3 + (limits.angular_acceleration,) * 3
        self._change = [limit * self._cycle / math.sqrt(3.0) for limit in most]

    @override
    def feed(self, order: Order, now: float) -> None:
        value = order.target
        assert isinstance(value, CartesianServo)
        if not _is_same(value.task, self._task):
            in_base = twist_in_base(vector(self._twist), "body", self._task)
            self._twist = twist_from_base(in_base, "body", value.task).tolist()
            if self._held is not None:
                self._held = relative(value.task, product(self._task, self._held))
            self._task = value.task
        speeds = zip(self._twist, value.modes, strict=True)
        self._twist = [0.0 if mode == AxisMode.POSITION else speed for speed, mode in speeds]
        # Near a singularity the tool may be behind, and axes that stay are to come back.
        self._held = aimed(value, self._inverse.pose(self._command), self._held)
        self._has_position = AxisMode.POSITION in value.modes
        self._wanted = value.twist.linear.tolist() + value.twist.angular.tolist()
        self._silence.feed(now)

    @override
    def point(self, now: float) -> Point:
        if self._fell_silent(now):
            self._wanted = [0.0] * 6
        assert self._held is not None
        ways = zip(self._twist, self._wanted, self._change, strict=True)
        self._twist = [old + min(max(new - old, -most), most) for old, new, most in ways]
        self._held = _moved_on(self._held, self._twist, self._cycle)
        pose = product(self._task, self._held)
        if self._takes_poses:
            return Point(self._inverse.setpoint(self._command, pose))
        before = self._feedback.reference_joints()
        near = self._feedback.expected_joints(self._cycle)
        joints = self._inverse.joints(self._command, pose, near)
        return self._pursuit.point(before, pose, joints, now)

    @property
    @override
    def behind(self) -> Vector:
        return self._pursuit.behind if self._has_position else empty()

    @property
    @override
    def is_over(self) -> bool:
        return super().is_over and max(map(abs, self._twist)) <= _STILL


def aimed(value: CartesianServo, here: Pose, held: Pose | None = None) -> Pose:
    """Return the pose, in the task frame, that a mixed setpoint begins with.

    Args:
        value: whose task frame is in the base frame.
        here: of the tool in the base frame, where axes of velocity begin.
        held: in the task frame, where axes without a mode stay; None if that is `here`.
    """
    poses: dict[int, Pose] = {AxisMode.POSITION: value.pose}
    if held is None or AxisMode.VELOCITY in value.modes:
        poses[AxisMode.VELOCITY] = relative(value.task, here)
    poses[AxisMode.NONE] = held or poses[AxisMode.VELOCITY]
    position = [float(poses[value.modes[axis]].position[axis]) for axis in range(3)]
    return Pose(vector(position), poses[value.modes[3]].orientation)


def _moved_on(pose: Pose, twist: list[float], time: float) -> Pose:
    """Return a pose after `time` seconds of a twist in the axes of its frame."""
    x, y, z, *turn = (speed * time for speed in twist)
    a, b, c = pose.position.tolist()
    orientation = pose.orientation
    if any(turn):
        orientation = unit(quaternion_product(quaternion_from_rotvec(vector(turn)), orientation))
    return Pose(vector((a + x, b + y, c + z)), orientation)


def _is_same(first: Pose, second: Pose) -> bool:
    known = second.position.tolist(), second.orientation.tolist()
    return (first.position.tolist(), first.orientation.tolist()) == known
