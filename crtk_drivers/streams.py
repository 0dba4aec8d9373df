"""Streams that go on between their commands, in the I/O thread: interpolate_*, and servo_cv on joints.

A stream takes commands as they come (`feed`) and says in each cycle what is to be sent (`step`). It begins
with the velocity and acceleration of the motion that it replaces, as far as they are known, and ends by
itself when no command came for its timeout and the motion has come to its end.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from crtk_drivers.arbiter import Order
from crtk_drivers.commands import COMMANDS, Kind
from crtk_drivers.device import Device, Mode, Setpoint
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.feedback import Feedback
from crtk_drivers.interpolation import JointInterpolator, PoseInterpolator, TwistInterpolator
from crtk_drivers.reach import Reach
from crtk_drivers.resolved_rate import ResolvedRate, increment_in_base
from crtk_drivers.samples import (
    JointState,
    Pose,
    Twist,
    Value,
    Vector,
    empty,
    joint_state,
    joint_values,
    vector,
)
from crtk_drivers.watchdog import Deadman

JOINT_MODES = {
    Kind.POSITION: Mode.JOINT_POSITION,
    Kind.RELATIVE: Mode.JOINT_POSITION,
    Kind.VELOCITY: Mode.JOINT_VELOCITY,
    Kind.EFFORT: Mode.JOINT_EFFORT,
}

_STILL = 1e-6
"""rad/s (m/s) of a joint that stands: what rounding leaves over."""

_LATE = 2.0
"""Cycles that a stream goes on at most in one of them, after a late one."""

_TOLERANCE = 0.01
"""By how much a joint may exceed its velocity limit between two poses: rounding."""

Clamp = Callable[[str, Vector, Vector], Vector]
"""Puts joint positions into their range: (command, positions, positions that it starts from)."""


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """What goes out in one cycle.

    Attributes:
        setpoint: to be sent.
        joints: what ``setpoint_js`` says of it; None if that follows from the setpoint alone.
        acceleration: (n,) of the joints, for the motion that follows; empty if unknown.
        twist: (6,) of the tool, the same.
    """

    setpoint: Setpoint
    joints: JointState | None = None
    acceleration: Vector = field(default_factory=empty)
    twist: Vector = field(default_factory=empty)


class Stream(ABC):
    """One stream while it runs; `name` is its command."""

    def __init__(self, name: str) -> None:
        self.name = name

    @abstractmethod
    def feed(self, order: Order, now: float) -> None:
        """Take a command of this name.

        Raises:
            CommandRefused: nothing is changed.
        """

    @abstractmethod
    def step(self, now: float) -> Point:
        """Return what to send now.

        Raises:
            CommandRefused: it cannot go on.
        """

    @property
    @abstractmethod
    def is_over(self) -> bool:
        """Whether it has timed out and its motion has ended."""

    @property
    @abstractmethod
    def goals(self) -> Mapping[str, Value]:
        """What ``goal_*`` say."""


class JointStream(Stream):
    """interpolate_jp, _jr, _jv and _jf.

    Args:
        name: of the command.
        device: whose limits and rate it keeps.
        feedback: where it begins.
        clamp: for goals out of range.
        timeout: seconds without a command after which it ends.
        now: monotonic seconds.
    """

    def __init__(
        self,
        name: str,
        device: Device,
        feedback: Feedback,
        clamp: Clamp,
        timeout: float,
        now: float,
    ) -> None:
        super().__init__(name)
        self._device = device
        self._clamp = clamp
        self._kind = COMMANDS[name].kind
        self._mode = JOINT_MODES[self._kind]
        capabilities = device.capabilities
        cycle = 1.0 / capabilities.rate
        self._interpolator = JointInterpolator(capabilities.limits, cycle, timeout, self._kind)
        position, velocity, acceleration = feedback.motion()
        before = now - cycle  # when that went out
        if self._mode is Mode.JOINT_POSITION:
            self._interpolator.start(position, before, velocity, acceleration)
        elif self._mode is Mode.JOINT_VELOCITY:
            self._interpolator.start(velocity, before, acceleration)
        else:
            effort = feedback.commanded_effort()
            at_rest = np.zeros(len(capabilities.joints))
            self._interpolator.start(effort if effort.size else at_rest, before)

    def feed(self, order: Order, now: float) -> None:
        """See the base class."""
        before = self._interpolator.goal
        if order.increment.size:
            goal = before + order.increment
        else:
            assert isinstance(order.target, JointState)
            goal = joint_values(self._kind, order.target)
        if self._mode is Mode.JOINT_POSITION:
            goal = self._clamp(self.name, goal, before)
        self._interpolator.command(goal, now)

    def step(self, now: float) -> Point:
        """See the base class."""
        point = self._interpolator.point(now)
        acceleration = {
            Mode.JOINT_POSITION: self._interpolator.acceleration,
            Mode.JOINT_VELOCITY: self._interpolator.rate,
        }.get(self._mode, empty())
        values = joint_values(self._kind, point)
        return Point(Setpoint(self._mode, values), point, acceleration)

    @property
    def is_over(self) -> bool:
        """See the base class."""
        return self._interpolator.is_over

    @property
    def goals(self) -> Mapping[str, Value]:
        """See the base class."""
        capabilities = self._device.capabilities
        state = joint_state(self._kind, self._interpolator.goal)
        goals: dict[str, Value] = {"goal_js": replace(state, name=capabilities.joints)}
        if self._mode is Mode.JOINT_POSITION and capabilities.has_kinematics:
            goals["goal_cp"] = self._device.forward_kinematics(state.position)
        return goals


class PoseStream(Stream):
    """interpolate_cp and _cr: as poses if the hardware takes them, else by inverse kinematics in each cycle.

    Args:
        name: of the command.
        device: whose limits and rate it keeps.
        feedback: where it begins; with the velocity of the tool, but not with its acceleration.
        reach: what can be reached.
        timeout: seconds without a command after which it ends.
        now: monotonic seconds.
    """

    def __init__(
        self,
        name: str,
        device: Device,
        feedback: Feedback,
        reach: Reach,
        timeout: float,
        now: float,
    ) -> None:
        super().__init__(name)
        self._device = device
        self._command = COMMANDS[name]
        self._reach = reach
        capabilities = device.capabilities
        limits = capabilities.cartesian_limits
        assert limits is not None
        self._takes_poses = Mode.CARTESIAN_POSITION in capabilities.modes
        cycle = 1.0 / capabilities.rate
        self._interpolator = PoseInterpolator(limits, cycle, timeout)
        self._interpolator.start(reach.pose(self._command), now - cycle, feedback.reference_twist())
        self._joints = feedback.reference_joints()
        self._rates = ResolvedRate(capabilities.limits, limits, cycle)
        most = [limit.velocity for limit in capabilities.limits]
        self._longest_step = vector(most) * (cycle * _LATE * (1.0 + _TOLERANCE))

    def feed(self, order: Order, now: float) -> None:
        """See the base class."""
        if order.displacement is not None:
            goal = increment_in_base(self._interpolator.goal, order.displacement)
            if not self._takes_poses:
                self._reach.joints(self._command, goal)
        else:
            assert isinstance(order.target, Pose)
            goal = order.target
        self._interpolator.command(goal, now)

    def step(self, now: float) -> Point:
        """See the base class."""
        pose, twist = self._interpolator.step(now)
        if self._takes_poses:
            return Point(self._reach.setpoint(self._command, pose), twist=vector(twist.vector))
        joints = self._reach.joints(self._command, pose, self._joints)
        step = np.abs(joints - self._joints)
        if (step > self._longest_step).any():
            names = self._device.capabilities.joints
            raise CommandRefused(
                self.name,
                Reason.STEP_TOO_LARGE,
                f"{names[int(np.argmax(step / self._longest_step))]} would be too fast on the way",
                where=self._device.address,
                remedy="Stay away from singularities, or use interpolate_jp.",
            )
        self._joints = joints
        rates = self._rates.follow_twist(joints, self._device.jacobian(joints), twist.vector)
        return Point(
            Setpoint(Mode.JOINT_POSITION, joints),
            JointState(position=joints, velocity=rates.velocity),
            twist=vector(twist.vector),
        )

    @property
    def is_over(self) -> bool:
        """See the base class."""
        return self._interpolator.is_over

    @property
    def goals(self) -> Mapping[str, Value]:
        """See the base class."""
        return {"goal_cp": self._interpolator.goal}


class TwistOutput:
    """Twists to the hardware: as they are if it takes them, else through the Jacobian.

    Joints take velocities if they can, else the positions to which these lead in each cycle. They keep
    the limits of position, velocity and acceleration, see `crtk_drivers.resolved_rate`.

    Args:
        device: whose modes, limits and rate it keeps.
        feedback: where it is, and how it moves at the beginning.
    """

    def __init__(self, device: Device, feedback: Feedback) -> None:
        capabilities = device.capabilities
        self._device = device
        self._feedback = feedback
        self._cycle = 1.0 / capabilities.rate
        self._takes_twists = Mode.CARTESIAN_VELOCITY in capabilities.modes
        self._takes_velocities = Mode.JOINT_VELOCITY in capabilities.modes
        limits = capabilities.cartesian_limits
        self._rates = ResolvedRate(capabilities.limits, limits, self._cycle)
        _, self._velocity, _ = feedback.motion()

    def point(self, twist: Vector) -> Point:
        """Return what to send for a twist (6,), base axes, in this cycle."""
        if self._takes_twists:
            return Point(Setpoint(Mode.CARTESIAN_VELOCITY, twist))
        joints = self._feedback.reference_joints()
        jacobian = self._device.jacobian(joints)
        rates = self._rates.follow_twist(joints, jacobian, twist, self._velocity)
        self._velocity = velocity = rates.velocity
        if self._takes_velocities:
            return Point(Setpoint(Mode.JOINT_VELOCITY, velocity), twist=twist)
        position = vector(joints + velocity * self._cycle)
        state = JointState(position=position, velocity=velocity)
        return Point(Setpoint(Mode.JOINT_POSITION, position), state, twist=twist)

    @property
    def is_at_rest(self) -> bool:
        """Whether the joints, if it moves these, have been told to stand."""
        return self._takes_twists or bool(np.abs(self._velocity).max() <= _STILL)


class ResolvedStream(Stream):
    """servo_cv on hardware that takes no twists: the newest twist, in each cycle.

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
        self._output = TwistOutput(device, feedback)
        self._silence = Deadman(timeout)
        self._silence.feed(now)
        self._twist = vector(np.zeros(6))

    def feed(self, order: Order, now: float) -> None:
        """See the base class."""
        assert isinstance(order.target, Twist)
        self._silence.feed(now)
        self._twist = vector(order.target.vector)

    def step(self, now: float) -> Point:
        """See the base class."""
        if self._silence.expired(now):
            self._silence.disarm()
            self._twist = vector(np.zeros(6))
        return self._output.point(self._twist)

    @property
    def is_over(self) -> bool:
        """See the base class."""
        return not self._silence.armed and self._output.is_at_rest

    @property
    def goals(self) -> Mapping[str, Value]:
        """None: a servo stream has no goal."""
        return {}


class TwistStream(Stream):
    """interpolate_cv.

    Args:
        name: of the command.
        device: whose limits and rate it keeps.
        feedback: where it begins.
        timeout: seconds without a command after which it ends.
        now: monotonic seconds.
    """

    def __init__(
        self, name: str, device: Device, feedback: Feedback, timeout: float, now: float
    ) -> None:
        super().__init__(name)
        capabilities = device.capabilities
        assert capabilities.cartesian_limits is not None
        self._base_frame = capabilities.base_frame
        cycle = 1.0 / capabilities.rate
        self._interpolator = TwistInterpolator(capabilities.cartesian_limits, cycle, timeout)
        self._interpolator.start(feedback.reference_twist(), now - cycle)
        self._output = TwistOutput(device, feedback)

    def feed(self, order: Order, now: float) -> None:
        """See the base class."""
        assert isinstance(order.target, Twist)
        self._interpolator.command(order.target.vector, now)

    def step(self, now: float) -> Point:
        """See the base class."""
        twist, _ = self._interpolator.step(now)
        return self._output.point(twist)

    @property
    def is_over(self) -> bool:
        """See the base class."""
        return self._interpolator.is_over and self._output.is_at_rest

    @property
    def goals(self) -> Mapping[str, Value]:
        """See the base class."""
        goal = self._interpolator.goal
        return {"goal_cv": Twist(goal[:3], goal[3:], self._base_frame)}
