"""servo_js and servo_cs whose axes follow values of different kinds, in the I/O thread.

Axes of position go to the newest position, axes of velocity move on from where they are, the others come to
rest. All are carried out as positions. When no command comes for the timeout, the axes of velocity slow down
and the stream is over.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from crtk_drivers.arbiter import Order
from crtk_drivers.commands import find
from crtk_drivers.device import Device, Mode, Setpoint
from crtk_drivers.feedback import Feedback, Point
from crtk_drivers.frames import inverse_pose, product, twist_from_base, twist_in_base
from crtk_drivers.geometry import quaternion_from_rotvec, quaternion_product
from crtk_drivers.limits import SetpointLimiter
from crtk_drivers.outputs import Pursuit
from crtk_drivers.reach import Reach
from crtk_drivers.resolved_rate import ResolvedRate
from crtk_drivers.samples import (
    AxisMode,
    CartesianServo,
    JointServo,
    Pose,
    Value,
    Vector,
    vector,
)
from crtk_drivers.streams import Stream
from crtk_drivers.watchdog import Deadman

_STILL = 1e-6
"""rad/s (m/s) of an axis that stands."""


class MixedJointStream(Stream):
    """servo_js with axes of position and of velocity.

    Args:
        name: of the command.
        device: whose limits and rate it keeps.
        feedback: where it begins.
        limiter: that the joints pass.
        timeout: seconds without a command after which it comes to rest.
        now: monotonic seconds.
    """

    def __init__(
        self,
        name: str,
        device: Device,
        feedback: Feedback,
        limiter: SetpointLimiter,
        timeout: float,
        now: float,
    ) -> None:
        super().__init__(name)
        capabilities = device.capabilities
        self._feedback = feedback
        self._limiter = limiter
        self._cycle = 1.0 / capabilities.rate
        self._rates = ResolvedRate(capabilities.limits, None, self._cycle)
        self._silence = Deadman(timeout)
        self._silence.feed(now)
        position, self._velocity, _ = feedback.motion(now)
        self._position = position
        self._wanted = vector(np.zeros(position.size))
        self._moves = np.zeros(position.size, dtype=bool)

    def feed(self, order: Order, now: float) -> None:
        """See the base class."""
        assert isinstance(order.target, JointServo)
        value, modes = order.target, np.array(order.target.modes)
        here = position = self._feedback.reference_joints()
        goes, moves = modes == AxisMode.POSITION, modes == AxisMode.VELOCITY
        if goes.any():
            position = vector(np.where(goes, value.position, here))
            self._limiter.check_speed(self.name, position, here, now)
        self._position, self._moves = position, ~goes
        self._wanted = value.velocity if moves.any() else vector(np.zeros(here.size))
        self._silence.feed(now)

    def step(self, now: float) -> Point:
        """See the base class."""
        if self._silence.expired(now):
            self._silence.disarm()
            self._wanted = vector(np.zeros(self._wanted.size))
        here = self._feedback.reference_joints()
        before = vector(np.where(self._moves, self._velocity, 0.0))
        self._velocity = self._rates.limited(here, self._wanted, before)
        moved = here + self._velocity * self._cycle
        return Point(
            Setpoint(Mode.JOINT_POSITION, vector(np.where(self._moves, moved, self._position)))
        )

    @property
    def is_over(self) -> bool:
        """See the base class."""
        return not self._silence.armed and bool(np.abs(self._velocity).max() <= _STILL)

    @property
    def goals(self) -> Mapping[str, Value]:
        """None: a servo stream has no goal."""
        return {}


class MixedAxesStream(Stream):
    """servo_cs with axes of position and of velocity, in a task frame.

    Args:
        name: of the command.
        device: whose limits and rate it keeps.
        feedback: where it begins.
        reach: what can be reached.
        limiter: that the joints pass.
        timeout: seconds without a command after which it is over.
        now: monotonic seconds.
    """

    def __init__(
        self,
        name: str,
        device: Device,
        feedback: Feedback,
        reach: Reach,
        limiter: SetpointLimiter,
        timeout: float,
        now: float,
    ) -> None:
        super().__init__(name)
        self._command = find(name)
        self._feedback = feedback
        self._reach = reach
        self._pursuit = Pursuit(device, limiter)
        self._takes_poses = Mode.CARTESIAN_POSITION in device.capabilities.modes
        self._cycle = 1.0 / device.capabilities.rate
        self._silence = Deadman(timeout)
        self._silence.feed(now)
        self._task = self._goal = reach.pose(self._command)
        self._has_goal = False
        self._twist = twist_from_base(feedback.reference_twist(now), "body", self._task)
        self._wanted = vector(np.zeros(6))
        limits = device.capabilities.cartesian_limits
        assert limits is not None
        most = (limits.linear_acceleration,) * 3 + (limits.angular_acceleration,) * 3
        self._change = np.array(most) * (self._cycle / np.sqrt(3.0))

    def feed(self, order: Order, now: float) -> None:
        """See the base class."""
        value = order.target
        assert isinstance(value, CartesianServo)
        in_base = twist_in_base(self._twist, "body", self._task)
        in_task = twist_from_base(in_base, "body", value.task)
        goes = np.array(value.modes) == AxisMode.POSITION
        self._twist = vector(np.where(goes, 0.0, in_task))
        here = self._reach.pose(self._command)
        # Near a singularity the tool may be behind, and axes that stay are to come back.
        held = product(self._task, self._goal) if self._has_goal else here
        self._task, self._has_goal = value.task, True
        self._goal = aimed(value, here, held)
        self._wanted = vector(value.twist.vector)
        self._silence.feed(now)

    def step(self, now: float) -> Point:
        """See the base class."""
        if self._silence.expired(now):
            self._silence.disarm()
            self._wanted = vector(np.zeros(6))
        change = np.clip(self._wanted - self._twist, -self._change, self._change)
        self._twist = vector(self._twist + change)
        self._goal = _moved_on(self._goal, self._twist, self._cycle)
        pose = product(self._task, self._goal)
        if self._takes_poses:
            return Point(self._reach.setpoint(self._command, pose))
        before = self._feedback.reference_joints()
        joints = self._reach.joints(self._command, pose, before)
        return self._pursuit.point(before, pose, joints, now)

    @property
    def is_over(self) -> bool:
        """See the base class."""
        return not self._silence.armed and bool(np.abs(self._twist).max() <= _STILL)

    @property
    def goals(self) -> Mapping[str, Value]:
        """None: a servo stream has no goal."""
        return {}


def aimed(value: CartesianServo, here: Pose, held: Pose) -> Pose:
    """Return the pose, in the task frame, that a mixed setpoint begins with.

    Args:
        value: whose task frame is in the base frame.
        here: of the tool in the base frame, where axes of velocity begin.
        held: the same, where axes without a mode stay.
    """
    into = inverse_pose(value.task)
    poses = {
        AxisMode.NONE: product(into, held),
        AxisMode.VELOCITY: product(into, here),
        AxisMode.POSITION: value.pose,
    }
    of_axes = [poses[AxisMode(mode)] for mode in value.modes]
    position = [pose.position[axis] for axis, pose in enumerate(of_axes[:3])]
    return Pose(vector(position), of_axes[3].orientation)


def _moved_on(pose: Pose, twist: Vector, time: float) -> Pose:
    """Return a pose after `time` seconds of a twist (6,) in the axes of its frame."""
    turned = quaternion_product(quaternion_from_rotvec(vector(twist[3:] * time)), pose.orientation)
    return Pose(vector(pose.position + twist[:3] * time), vector(turned / np.linalg.norm(turned)))
