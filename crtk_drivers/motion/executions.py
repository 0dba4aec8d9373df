"""Moves while they run, in the I/O thread: by the hardware, or along a trajectory of ours."""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np
from typing_extensions import override

from crtk_drivers.commands import find
from crtk_drivers.device import Capabilities, Mode, MoveProgress, Setpoint
from crtk_drivers.errors import MotionAborted
from crtk_drivers.motion.activity import Activity
from crtk_drivers.motion.arbiter import Order, Path
from crtk_drivers.motion.arriving import Arriving
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.move import Progress, Violated
from crtk_drivers.motion.output import Output
from crtk_drivers.motion.point import Point
from crtk_drivers.motion.stopping import SLOWEST_PACE
from crtk_drivers.motion.tool import PoseOutput
from crtk_drivers.samples import JointState, vector
from crtk_drivers.state import OperatingState
from crtk_drivers.trajectory.profiles import JointProfile, LineProfile
from crtk_drivers.trajectory.tolerances import Limits
from crtk_drivers.trajectory.waypoints import JoinedPath

ARRIVAL_TIMEOUT: Final = 10.0
"""Seconds, at full pace, in which hardware that smooths setpoints must be where a trajectory of ours ends, or
have come nearer."""

SETTLING_TIME: Final = 2.0
"""Seconds in which the joints must be measured at the goal of a move that the hardware says it has ended, or
have come nearer."""

_WITHIN: Final = 0.99
"""Of the largest step: it is measured in positions, which are rounded."""

PACE_TIME: Final = 0.2
"""Seconds in which a trajectory goes from rest to full pace, or back, where the hardware's own pace jumps."""


def is_native(order: Order, capabilities: Capabilities) -> bool:
    """Whether the hardware plans the way to the goal of an order."""
    goal = order.goal
    if goal is None or order.path is not None:
        return False
    name = "move_jp" if goal.pose is None else "move_cp"
    return name in capabilities.native_moves


def begin_move(
    order: Order, context: MotionContext, now: float, before: Activity | None
) -> NativeMove | StreamedMove:
    """Begin the move of an order at monotonic seconds.

    Args:
        order: has a goal.
        context: of the device.
        now: monotonic seconds.
        before: what it replaces, with whose motion a trajectory of ours goes on.

    Raises:
        CommandRefused, MotionAborted: there is no way to the goal from here.
        DeviceError: the hardware could not be told.
    """
    assert order.goal is not None
    if is_native(order, context.capabilities):
        if context.board.status.state is not OperatingState.ENABLED:  # by the watchdog, just now
            raise MotionAborted(f"the device is {context.board.status.state}")
        context.feedback.follow_device()
        context.stopping.moves_again()
        context.stopping.motion_sent()
        return NativeMove(order, context)
    if isinstance(before, StreamedMove):
        pace = before.pace
    else:
        pace = 1.0 if context.feedback.motion(now)[1].any() else context.device.pace
    # In the time of the trajectory, in which the motion that it goes on from is as much faster.
    share = 1.0 / pace if pace > SLOWEST_PACE else 0.0
    if order.path is not None:
        return FollowedPath(order, order.path, context, now, pace, share)
    way = (_JointWay if order.goal.pose is None else _LineWay)(order, context, now, share)
    return StreamedMove(order, context, way, now, pace)


class Way(Protocol):
    """A trajectory of ours; `duration` in s."""

    duration: float

    def point(self, time: float, step: float) -> Point:
        """Return what to send `time` seconds after its start, and `step` after the last."""


class NativeMove(Activity):
    """The hardware plans and executes; this one watches."""

    def __init__(self, order: Order, context: MotionContext) -> None:
        super().__init__(order.name, order.stamp_ns, order.move)
        assert order.goal is not None
        self._device = context.device
        self._stopping = context.stopping
        self._joints = order.joints
        self._arriving = Arriving(context, order.joints)
        self._ended: float | None = None
        self._device.move(order.goal)

    @override
    def step(self, now: float, output: Output) -> bool:
        """Ask the hardware how far it is, and look whether it is there when it says so."""
        progress = self._device.move_progress()
        if progress is MoveProgress.FAILED:
            raise MotionAborted(f"the hardware ended {self.name} before its goal")
        if progress is not MoveProgress.DONE:
            self._stopping.motion_sent()
            return False
        if self._ended is None:
            self._ended = now
        missing = output.missing(self._joints, self._ended)
        late = now - self._ended
        if late - self._arriving.came_nearer(late) > SETTLING_TIME and missing:
            raise MotionAborted(
                f"the hardware says that {self.name} has ended, but {missing}",
                remedy="Look at what holds it.",
            )
        return missing == "" and self._arriving.rests(late)


class StreamedMove(Activity):
    """A trajectory of our own, sent point by point.

    After a late cycle the profile goes on from where it was, at most two periods further, and no further than
    the limits let through at once: no burst and no jump, the motion just takes longer. So it does where the
    hardware is slowed down.

    Args:
        order: of the move.
        context: of the device.
        way: to its goal.
        now: monotonic seconds.
        pace: of the trajectory at its beginning, of real time.

    Attributes:
        pace: of the trajectory now; that of the hardware, not faster than `PACE_TIME`.
    """

    def __init__(
        self,
        order: Order,
        context: MotionContext,
        way: Way,
        now: float,
        pace: float,
    ) -> None:
        super().__init__(order.name, order.stamp_ns, order.move)
        self._device = context.device
        self._goal = order.joints
        self._way = way
        self._ended: float | None = None
        self._arriving = Arriving(context, order.joints)
        self._last = now - context.cycle  # when the setpoint went out from which it starts
        self._longest = min(2.0 * context.cycle, _WITHIN * context.options.limits.max_step)
        self._time = 0.0
        self.pace = pace

    @override
    def step(self, now: float, output: Output) -> bool:
        """Send the next point; at the end the last one, until the hardware is there."""
        passed = min(now - self._last, self._longest)
        self._last = now
        change = passed / PACE_TIME
        self.pace = min(max(self._device.pace, self.pace - change), self.pace + change)
        step = self.pace * passed
        self._time += step
        point = self._way.point(self._time, step).at_pace(self.pace)
        output.send_limited(self.name, point, now)
        self._look(point)
        late = self._time - self._way.duration
        if late < 0.0:
            return False
        if self._ended is None:
            self._ended = now
        return self._is_there(late, output)

    def _look(self, point: Point) -> None:
        """A point was sent: see whether all is well."""

    def _is_there(self, late: float, output: Output) -> bool:
        """Return whether the hardware is where it ends, `late` seconds after it should be."""
        assert self._ended is not None
        missing = output.missing(self._goal, self._ended)
        if late - self._arriving.came_nearer(late) > ARRIVAL_TIMEOUT:
            raise MotionAborted(
                f"the hardware has not come to rest where {self.name} ends in {ARRIVAL_TIMEOUT:g} s"
                + (f": {missing}" if missing else ""),
                remedy="Look at what holds it.",
            )
        return self._device.has_arrived and missing == "" and self._arriving.rests(late)


class FollowedPath(StreamedMove):
    """A trajectory that a client gave, within its tolerances.

    Args:
        order, context, now, pace: see `StreamedMove`.
        path: the trajectory.
        share: as for `PoseOutput`.
    """

    def __init__(
        self,
        order: Order,
        path: Path,
        context: MotionContext,
        now: float,
        pace: float,
        share: float,
    ) -> None:
        super().__init__(order, context, _GivenWay(path, context, now, share), now, pace)
        self._tolerances = path.tolerances
        self._feedback = context.feedback
        self._rest = JointState(position=order.joints, velocity=vector(np.zeros_like(order.joints)))

    @override
    def _look(self, point: Point) -> None:
        assert self.move is not None
        assert point.joints is not None
        actual, _ = self._feedback.measured_state()
        self.move.progress = Progress(self._time, point.joints, actual)
        if self._time < self._way.duration:
            self._judge(self._tolerances.path, point.joints, Violated.PATH)

    @override
    def _is_there(self, late: float, output: Output) -> bool:
        assert self._ended is not None
        actual, at = self._feedback.measured_state()
        if at >= self._ended and not self._tolerances.goal.violated(self._rest, actual):
            return True
        if late > (self._tolerances.goal_time or ARRIVAL_TIMEOUT):
            self._judge(self._tolerances.goal, self._rest, Violated.GOAL)
        return False

    def _judge(self, limits: Limits, desired: JointState, violated: Violated) -> None:
        text = limits.violated(desired, self._feedback.measured_state()[0])
        if text:
            assert self.move is not None
            self.move.violated = violated
            raise MotionAborted(f"the {violated} tolerance of {self.name} is violated: {text}")


class _GivenWay:
    """A given trajectory, from the motion that goes on at `now`; `share` as for `PoseOutput`."""

    def __init__(self, path: Path, context: MotionContext, now: float, share: float) -> None:
        position, velocity, acceleration = context.feedback.motion(now)
        motion = position, vector(velocity * share), vector(acceleration * share * share)
        begin = 0.0 if path.starts is None else now - path.starts
        self._joined = JoinedPath(path.spline, begin, motion, context.capabilities.limits)
        self.duration = self._joined.duration

    def point(self, time: float, step: float) -> Point:
        """Return what to send `time` seconds after it was joined."""
        position, velocity, acceleration = self._joined.state(time)
        state = JointState(position=position, velocity=velocity)
        return Point(Setpoint(Mode.JOINT_POSITION, position), state, acceleration)


class _JointWay:
    """A profile of the joints, from the motion that goes on at `now`; `share` as for `PoseOutput`."""

    def __init__(self, order: Order, context: MotionContext, now: float, share: float) -> None:
        assert order.goal is not None
        position, velocity, acceleration = context.feedback.motion(now)
        self._profile = JointProfile(
            position,
            vector(velocity * share),
            vector(acceleration * share * share),
            order.joints,
            context.capabilities.move_limits or context.capabilities.limits,
            order.goal.ratios,
        )
        self.duration = self._profile.duration

    def point(self, time: float, step: float) -> Point:
        """Return what to send `time` seconds of the profile after its start, and `step` after the last."""
        position, velocity, acceleration = self._profile.state(time)
        state = JointState(position=position, velocity=velocity)
        return Point(Setpoint(Mode.JOINT_POSITION, position), state, acceleration)


class _LineWay:
    """A straight line of the tool, from the motion that goes on at `now`; `share` as for `PoseOutput`."""

    def __init__(self, order: Order, context: MotionContext, now: float, share: float) -> None:
        command, capabilities, feedback = find(order.name), context.capabilities, context.feedback
        limits = capabilities.line_limits or capabilities.cartesian_limits
        assert limits is not None
        assert order.goal is not None
        assert order.goal.pose is not None
        self._profile = LineProfile(
            context.inverse.pose(command),
            order.goal.pose,
            limits,
            order.goal.ratios,
            vector(feedback.reference_twist(now) * share),
            vector(feedback.reference_twist_change(now) * share * share),
        )
        self._output = PoseOutput(command, context, now, share)
        self.duration = self._profile.duration

    def point(self, time: float, step: float) -> Point:
        """Return what to send `time` seconds of the line after its start, and `step` after the last."""
        return self._output.point(*self._profile.at(time), step)
