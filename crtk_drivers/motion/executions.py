"""Moves while they run, in the I/O thread: by the hardware, or along a trajectory of ours."""

from __future__ import annotations

from typing import Final

from typing_extensions import override

from crtk_drivers.commands import find
from crtk_drivers.device import Capabilities, Goal, Mode, MoveProgress, Setpoint
from crtk_drivers.errors import MotionAborted
from crtk_drivers.motion.activity import Activity
from crtk_drivers.motion.arbiter import Order
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.output import Output
from crtk_drivers.motion.point import Point
from crtk_drivers.motion.stopping import SLOWEST_PACE
from crtk_drivers.motion.tool import PoseOutput
from crtk_drivers.samples import JointState, vector
from crtk_drivers.trajectory.profiles import JointProfile, LineProfile

ARRIVAL_TIMEOUT: Final = 10.0
"""Seconds, at full pace, in which hardware that smooths setpoints must be where a trajectory of ours ends."""

SETTLING_TIME: Final = 2.0
"""Seconds in which the joints must be measured at the goal of a move that the hardware says it has ended."""

PACE_TIME: Final = 0.2
"""Seconds in which a trajectory goes from rest to full pace, or back, where the hardware's own pace jumps."""


def is_native(goal: Goal, capabilities: Capabilities) -> bool:
    """Whether the hardware plans the way to a goal."""
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
    if is_native(order.goal, context.capabilities):
        context.feedback.follow_device()
        context.stopping.moves_again()
        return NativeMove(order, context)
    if isinstance(before, StreamedMove):
        pace = before.pace
    else:
        pace = 1.0 if context.feedback.motion(now)[1].any() else context.device.pace
    # In the time of the trajectory, in which the motion that it goes on from is as much faster.
    share = 1.0 / pace if pace > SLOWEST_PACE else 0.0
    way = (_JointWay if order.goal.pose is None else _LineWay)(order, context, now, share)
    return StreamedMove(order, context, way, now, pace)


class NativeMove(Activity):
    """The hardware plans and executes; this one watches."""

    def __init__(self, order: Order, context: MotionContext) -> None:
        super().__init__(order.name, order.stamp_ns, order.move)
        assert order.goal is not None
        self._device = context.device
        self._joints = order.joints
        self._ended: float | None = None
        self._device.move(order.goal)

    @override
    def step(self, now: float, output: Output) -> bool:
        """Ask the hardware how far it is, and look whether it is there when it says so."""
        progress = self._device.move_progress()
        if progress is MoveProgress.FAILED:
            raise MotionAborted(f"the hardware ended {self.name} before its goal")
        if progress is not MoveProgress.DONE:
            return False
        if self._ended is None:
            self._ended = now
        missing = output.missing(self._joints, self._ended)
        if missing and now - self._ended > SETTLING_TIME:
            raise MotionAborted(
                f"the hardware says that {self.name} has ended, but {missing}",
                remedy="Look at what holds it.",
            )
        return missing == ""


class StreamedMove(Activity):
    """A trajectory of our own, sent point by point.

    After a late cycle the profile goes on from where it was, at most two periods further: no burst and
    no jump, the motion just takes longer. So it does where the hardware is slowed down.

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
        way: _JointWay | _LineWay,
        now: float,
        pace: float,
    ) -> None:
        super().__init__(order.name, order.stamp_ns, order.move)
        self._device = context.device
        self._goal = order.joints
        self._way = way
        self._ended: float | None = None
        self._last = now - context.cycle  # when the setpoint went out from which it starts
        self._longest = 2.0 * context.cycle
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
        output.send_limited(self.name, self._way.point(self._time, step).at_pace(self.pace), now)
        late = self._time - self._way.duration
        if late < 0.0:
            return False
        if self._ended is None:
            self._ended = now
        missing = output.missing(self._goal, self._ended)
        if late > ARRIVAL_TIMEOUT:
            raise MotionAborted(
                f"the hardware has not come to rest where {self.name} ends in {ARRIVAL_TIMEOUT:g} s"
                + (f": {missing}" if missing else ""),
                remedy="Look at what holds it.",
            )
        return self._device.has_arrived and missing == ""


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
