"""servo_js and servo_cs whose axes follow values of different kinds, in the I/O thread.

Axes of position go to the newest position, axes of velocity move on from where they are, the others stay.
Both are carried out as positions. When no command comes for the timeout, the axes of velocity slow down and
the stream is over.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from crtk_drivers.arbiter import Order
from crtk_drivers.commands import find
from crtk_drivers.device import Device, Mode, Setpoint
from crtk_drivers.feedback import Feedback, Point
from crtk_drivers.frames import inverse_pose, product
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
        timeout: seconds without a command after which it comes to rest.
        now: monotonic seconds.
    """

    def __init__(
        self, name: str, device: Device, feedback: Feedback, timeout: float, now: float
    ) -> None:
        super().__init__(name)
        capabilities = device.capabilities
        self._feedback = feedback
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
        self._silence.feed(now)
        here = self._feedback.reference_joints()
        goes = modes == AxisMode.POSITION
        self._position = vector(np.where(goes, value.position, here)) if goes.any() else here
        self._moves = modes == AxisMode.VELOCITY
        wanted = value.velocity if self._moves.any() else np.zeros(here.size)
        self._wanted = vector(wanted)

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
        self._limiter = limiter
        self._pursuit = Pursuit(device)
        self._takes_poses = Mode.CARTESIAN_POSITION in device.capabilities.modes
        self._cycle = 1.0 / device.capabilities.rate
        self._silence = Deadman(timeout)
        self._silence.feed(now)
        self._task = self._goal = reach.pose(self._command)
        limits = device.capabilities.cartesian_limits
        assert limits is not None
        most = (limits.linear_acceleration,) * 3 + (limits.angular_acceleration,) * 3
        self._change = np.array(most) * (self._cycle / np.sqrt(3.0))
        self._twist = self._wanted = vector(np.zeros(6))

    def feed(self, order: Order, now: float) -> None:
        """See the base class."""
        value = order.target
        assert isinstance(value, CartesianServo)
        modes = np.array(value.modes)
        # Where the tool is sent now, as the task frame sees it.
        here = product(inverse_pose(value.task), self._reach.pose(self._command))
        goes, moves = modes == AxisMode.POSITION, modes == AxisMode.VELOCITY
        position = np.where(goes[:3], value.pose.position, here.position)
        orientation = value.pose.orientation if goes[3] else here.orientation
        self._task = value.task
        self._goal = Pose(vector(position), orientation)
        self._wanted = vector(np.where(moves, value.twist.vector, 0.0))
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
        if self._limiter.can_step(joints, before, now):
            return Point(Setpoint(Mode.JOINT_POSITION, joints))
        return self._pursuit.point(before, pose)

    @property
    def is_over(self) -> bool:
        """See the base class."""
        return not self._silence.armed and bool(np.abs(self._twist).max() <= _STILL)

    @property
    def goals(self) -> Mapping[str, Value]:
        """None: a servo stream has no goal."""
        return {}


def _moved_on(pose: Pose, twist: Vector, time: float) -> Pose:
    """Return a pose after `time` seconds of a twist (6,) in the axes of its frame."""
    turned = quaternion_product(quaternion_from_rotvec(vector(twist[3:] * time)), pose.orientation)
    return Pose(vector(pose.position + twist[:3] * time), vector(turned / np.linalg.norm(turned)))
