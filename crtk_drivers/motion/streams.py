"""Streams, in the I/O thread.

Most go on between their commands: interpolate_*, and of servo_* those that change with the arm's own motion:
twists and wrenches that joints carry out or that are given in the tool's axes, poses that joints follow, and
mixed setpoints. Any other command of servo_* is sent as it comes (`DirectStream`).

A stream takes commands as they come (`feed`) and says in each cycle what is to be sent (`point`). It begins
with the velocity and acceleration of the motion that it replaces, as far as they are known, and ends by
itself when no command came for its timeout and the motion has come to its end.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping

import numpy as np
from typing_extensions import override

from crtk_drivers.commands import Command, Kind, Level, Space, find
from crtk_drivers.device import Mode, Setpoint, mode_of
from crtk_drivers.geometry.frames import (
    moved,
    twist_from_base,
    twist_in_base,
    wrench_from_base,
    wrench_in_base,
)
from crtk_drivers.motion.activity import Activity
from crtk_drivers.motion.arbiter import Order
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.output import Output
from crtk_drivers.motion.point import Point
from crtk_drivers.motion.tool import PoseOutput, Pursuit, TwistOutput, WrenchOutput
from crtk_drivers.samples import (
    JointState,
    Pose,
    Twist,
    Value,
    Vector,
    Wrench,
    empty,
    joint_state,
    joint_values,
    vector,
)
from crtk_drivers.status.deadman import Deadman
from crtk_drivers.trajectory.interpolators import (
    JointInterpolator,
    PoseInterpolator,
    TwistInterpolator,
    WrenchInterpolator,
)
from crtk_drivers.trajectory.smoothing import LONGEST_STEP


class Stream(Activity):
    """One stream while it runs.

    Args:
        name: of its command.
        context: of the device.
        now: monotonic seconds at which it begins.
    """

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name)
        self._command = find(name)
        self._context = context
        self._feedback = context.feedback
        self._inverse = context.inverse
        self._cycle = context.cycle
        self._timeout = context.options.silence(self._command.level)

    @override
    def step(self, now: float, output: Output) -> bool:
        stamp_ns = self.stamp_ns if self._command.level is Level.SERVO else 0
        self.sent(output.send_limited(self.name, self.point(now), now, stamp_ns))
        return self.is_over

    @abstractmethod
    def feed(self, order: Order, now: float) -> None:
        """Take a command of this name.

        Raises:
            CommandRefused: nothing is changed.
        """

    @abstractmethod
    def point(self, now: float) -> Point:
        """Return what to send now.

        Raises:
            CommandRefused: it cannot go on.
        """

    def sent(self, setpoint: Setpoint) -> None:
        """What went out of this cycle's `point`, within the limits."""

    @property
    @abstractmethod
    def is_over(self) -> bool:
        """Whether it has timed out and its motion has ended."""

    @property
    def behind(self) -> Vector:
        """How far (n,) the joints are from the pose that was sent last; empty if they are there."""
        return empty()

    @property
    def goals(self) -> Mapping[str, Value]:
        """What ``goal_*`` say; a servo stream has no goal."""
        return {}


class ServoStream(Stream):
    """A stream of servo_*; without a command for its timeout it comes to rest."""

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name, context, now)
        self._silence = Deadman(self._timeout)
        self._silence.feed(now)

    def _fell_silent(self, now: float) -> bool:
        """Whether no command came for the timeout; from then on this stays so until the next one."""
        if self._silence.expired(now):
            self._silence.disarm()
        return not self._silence.armed

    @property
    @override
    def is_over(self) -> bool:
        return not self._silence.armed


class DirectStream(ServoStream):
    """Commands of servo_* that the hardware takes as they are, each sent once, when it comes.

    In between nothing new is sent, but of a velocity: it is lowered where the range of a joint comes near. It
    takes commands of any name.
    """

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name, context, now)
        self._limiter = context.limiter
        self._target: Setpoint | None = None
        self._due: Setpoint | None = None

    @override
    def feed(self, order: Order, now: float) -> None:
        target = direct_target(order, self._context)
        before = self._target.mode if self._target is not None else None
        if target.mode is Mode.JOINT_POSITION is not before:
            position, velocity, _ = self._feedback.motion(now)
            self._limiter.check_start(order.name, target.values, position, velocity)
        self._due = self._context.limit(order.name, target, now)
        self._target = target
        self.name = order.name
        self._silence.feed(now)

    @override
    def step(self, now: float, output: Output) -> bool:
        due, self._due = self._due, None
        if due is not None:
            output.send(Point(due), now, self.stamp_ns)
        elif self._fell_silent(now):
            return True
        else:
            self._go_on(now, output)
        return False

    @override
    def point(self, now: float) -> Point:
        assert self._target is not None
        before = self._feedback.before(self._target.mode, now)
        return Point(self._limiter.judge(self.name, self._target, before).setpoint)

    def _go_on(self, now: float, output: Output) -> None:
        last = output.last
        if last is not None and last.mode.kind is Kind.VELOCITY:
            point = self.point(now)
            if point.setpoint.values.tolist() != last.values.tolist():
                output.send(point, now, self.stamp_ns)
                return
        output.repeat()


def direct_target(order: Order, context: MotionContext) -> Setpoint:
    """Return where an order of a `DirectStream` leads from the setpoint in force.

    Raises:
        CommandRefused: out of reach.
    """
    if order.setpoint is not None:
        return order.setpoint
    if order.displacement is not None:
        command = find(order.name)
        return context.inverse.setpoint(command, context.inverse.moved(command, order.displacement))
    target = vector(context.feedback.reference_joints() + order.increment)
    return Setpoint(Mode.JOINT_POSITION, target)


class JointStream(Stream):
    """interpolate_jp, _jr, _jv and _jf."""

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name, context, now)
        self._kind = self._command.kind
        self._mode = mode_of(Space.JOINT, self._kind)
        limits, cycle = context.capabilities.limits, self._cycle
        self._interpolator = JointInterpolator(limits, cycle, self._timeout, self._kind)
        position, velocity, acceleration = self._feedback.motion(now)
        before = now - cycle  # when that went out
        if self._mode is Mode.JOINT_POSITION:
            self._interpolator.start(position, before, velocity, acceleration)
        elif self._mode is Mode.JOINT_VELOCITY:
            self._interpolator.start(velocity, before, acceleration)
        else:
            effort = self._feedback.commanded_effort()
            self._interpolator.start(effort if effort.size else np.zeros(len(limits)), before)

    @override
    def feed(self, order: Order, now: float) -> None:
        before = self._interpolator.goal
        if order.increment.size:
            goal = before + order.increment
        else:
            assert isinstance(order.target, JointState)
            goal = joint_values(self._kind, order.target)
        if self._mode is Mode.JOINT_POSITION:
            goal = self._context.into_range(self.name, goal, before)
        self._interpolator.command(goal, now)

    @override
    def point(self, now: float) -> Point:
        point = self._interpolator.point(now)
        acceleration = {
            Mode.JOINT_POSITION: self._interpolator.acceleration,
            Mode.JOINT_VELOCITY: self._interpolator.rate,
        }.get(self._mode, empty())
        values = joint_values(self._kind, point)
        return Point(Setpoint(self._mode, values), point, acceleration)

    @override
    def sent(self, setpoint: Setpoint) -> None:
        """The end of a range slows velocities: they go on from what it left."""
        if self._mode is Mode.JOINT_VELOCITY:
            self._interpolator.held_at(setpoint.values)

    @property
    @override
    def is_over(self) -> bool:
        return self._interpolator.is_over

    @property
    @override
    def goals(self) -> Mapping[str, Value]:
        state = joint_state(self._kind, self._interpolator.goal)
        goals: dict[str, Value] = {"goal_js": state}
        kinematics = self._context.device.kinematics
        if self._mode is Mode.JOINT_POSITION and kinematics is not None:
            goals["goal_cp"] = kinematics.forward(state.position)
        return goals


class PoseStream(Stream):
    """interpolate_cp and _cr."""

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name, context, now)
        capabilities, cycle = context.capabilities, self._cycle
        limits = capabilities.cartesian_limits
        assert limits is not None
        self._base = capabilities.base_pose
        self._takes_poses = Mode.CARTESIAN_POSITION in capabilities.modes
        self._interpolator = PoseInterpolator(limits, cycle, self._timeout)
        self._interpolator.start(
            self._inverse.pose(self._command),
            now - cycle,
            self._feedback.reference_twist(now),
            self._feedback.reference_twist_change(now),
        )
        self._output = PoseOutput(self._command, context, now)
        self._last = now - cycle
        self._longest = LONGEST_STEP * cycle

    @override
    def feed(self, order: Order, now: float) -> None:
        if order.displacement is not None:
            command, inverse = self._command, self._inverse
            goal = moved(self._interpolator.goal, order.displacement, order.frame, self._base)
            if self._takes_poses:
                inverse.check_way(command, goal)
            else:
                inverse.joints(command, goal, inverse.reference(command))
        else:
            assert isinstance(order.target, Pose)
            goal = order.target
        self._interpolator.command(goal, now)

    @override
    def point(self, now: float) -> Point:
        pose, twist = self._interpolator.step(now)
        step = min(max(0.0, now - self._last), self._longest)  # as far as that has gone on
        self._last = now
        return self._output.point(pose, vector(twist.vector), step)

    @property
    @override
    def is_over(self) -> bool:
        return self._interpolator.is_over

    @property
    @override
    def goals(self) -> Mapping[str, Value]:
        return {"goal_cp": self._interpolator.goal}


class PursuitStream(ServoStream):
    """servo_cp and _cr on joints; when it falls silent it goes no further."""

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name, context, now)
        self._base = context.capabilities.base_pose
        self._limiter = context.limiter
        self._pursuit = Pursuit(context)
        self._goal: Pose | None = None
        self._joints = empty()
        self._velocity: Vector | None = self._feedback.motion(now)[1]  # until the first step

    @override
    def feed(self, order: Order, now: float) -> None:
        if order.displacement is not None:
            here = self._inverse.pose(self._command)
            goal = moved(self._goal or here, order.displacement, order.frame, self._base)
            near = self._feedback.expected_joints(self._cycle)
            joints = self._inverse.joints(self._command, goal, near)
            self._limiter.judge_tool(self.name, goal, here)
        else:
            assert isinstance(order.target, Pose)
            assert order.setpoint is not None
            goal, joints = order.target, order.setpoint.values
        self._goal, self._joints = goal, joints
        self._silence.feed(now)

    @override
    def point(self, now: float) -> Point:
        assert self._goal is not None
        before = self._feedback.reference_joints()
        if self._fell_silent(now):
            return Point(Setpoint(Mode.JOINT_POSITION, before))
        velocity, self._velocity = self._velocity, None
        may_jump = velocity is None or self._limiter.can_start(self._joints, before, velocity)
        return self._pursuit.point(before, self._goal, self._joints, now, may_jump)

    @property
    @override
    def behind(self) -> Vector:
        return self._pursuit.behind


class _InFrame:
    """A twist or wrench that is given in the frame of a command's sub-namespace."""

    def __init__(self, command: Command, context: MotionContext) -> None:
        self._command = command
        self._base = context.capabilities.base_pose
        self._inverse = context.inverse
        is_twist = command.kind is Kind.VELOCITY
        self._in_base = twist_in_base if is_twist else wrench_in_base
        self._from_base = twist_from_base if is_twist else wrench_from_base

    def in_base(self, values: Vector) -> Vector:
        """Return it (6,) in base axes at the tool point, where the tool is now."""
        return self._turned(self._in_base, values)

    def from_base(self, values: Vector) -> Vector:
        """Return in its frame what is given in base axes."""
        return self._turned(self._from_base, values)

    def _turned(self, convert: Callable[..., Vector], values: Vector) -> Vector:
        frame = self._inverse.frame_of(self._command)
        if not frame:
            return values
        return convert(values, frame, self._inverse.pose(self._command), self._base)


def _output(command: Command, context: MotionContext, now: float) -> TwistOutput | WrenchOutput:
    is_twist = command.kind is Kind.VELOCITY
    return TwistOutput(context, now) if is_twist else WrenchOutput(context)


class HeldStream(ServoStream):
    """servo_cv and servo_cf: the newest twist or wrench, carried out anew in each cycle."""

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name, context, now)
        self._frame = _InFrame(self._command, context)
        self._output = _output(self._command, context, now)
        self._values = vector(np.zeros(6))

    @override
    def feed(self, order: Order, now: float) -> None:
        assert isinstance(order.target, Twist | Wrench)
        self._silence.feed(now)
        self._values = vector(order.target.vector)

    @override
    def point(self, now: float) -> Point:
        if self._fell_silent(now):
            self._values = vector(np.zeros(6))
        return self._output.point(self._frame.in_base(self._values))

    @property
    @override
    def is_over(self) -> bool:
        return super().is_over and self._output.is_at_rest


class SmoothStream(Stream):
    """interpolate_cv and interpolate_cf: as `HeldStream`, smoothed in the frame in which they are given."""

    def __init__(self, name: str, context: MotionContext, now: float) -> None:
        super().__init__(name, context, now)
        limits = context.capabilities.cartesian_limits
        assert limits is not None
        self._is_twist = self._command.kind is Kind.VELOCITY
        self._frame = _InFrame(self._command, context)
        self._output = _output(self._command, context, now)
        self._interpolator: TwistInterpolator | WrenchInterpolator
        if self._is_twist:
            self._interpolator = TwistInterpolator(limits, self._cycle, self._timeout)
            start = self._feedback.reference_twist(now)
        else:
            self._interpolator = WrenchInterpolator(limits, self._cycle, self._timeout)
            start = self._feedback.commanded_wrench()
        self._interpolator.start(self._frame.from_base(start), now - self._cycle)

    @override
    def feed(self, order: Order, now: float) -> None:
        assert isinstance(order.target, Twist | Wrench)
        self._interpolator.command(order.target.vector, now)

    @override
    def point(self, now: float) -> Point:
        values, _ = self._interpolator.step(now)
        point = self._output.point(self._frame.in_base(values))
        if isinstance(self._output, TwistOutput):
            self._interpolator.held_at(vector(self._output.share * values))
        return point

    @override
    def sent(self, setpoint: Setpoint) -> None:
        if setpoint.mode is Mode.CARTESIAN_VELOCITY:
            self._interpolator.held_at(self._frame.from_base(setpoint.values))

    @property
    @override
    def is_over(self) -> bool:
        return self._interpolator.is_over and self._output.is_at_rest

    @property
    @override
    def goals(self) -> Mapping[str, Value]:
        if not self._is_twist:
            return {}
        goal = self._frame.in_base(self._interpolator.goal)
        return {"goal_cv": Twist(goal[:3], goal[3:], self._context.capabilities.base_frame)}
