"""Motion in the I/O thread: takes orders, writes setpoints, follows moves, ends streams.

At any time one of five things is going on: nothing (the position is held), a servo stream, a stream
that goes on between its commands, a move, or free drive. An order ends what was going on before it begins
its own. A stream, or a move along a trajectory of ours, that takes over from a motion of the hardware's own
waits until that has come to its end.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping

import numpy as np

from crtk_drivers.commands import Command, Kind, Level, Space, find
from crtk_drivers.device import Goal, Mode, Setpoint, Steps, mode_of
from crtk_drivers.errors import (
    REPORT,
    CommandRefused,
    CrtkError,
    DeviceFault,
    MotionAborted,
    Reason,
)
from crtk_drivers.motion.arbiter import Arbiter, Order, combined
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.executions import (
    LineMove,
    MoveExecution,
    NativeMove,
    ProfileMove,
    StreamedMove,
)
from crtk_drivers.motion.feedback import Point
from crtk_drivers.motion.following import FollowingWatch
from crtk_drivers.motion.mixed import MixedAxesStream, MixedJointStream
from crtk_drivers.motion.streams import (
    HeldStream,
    JointStream,
    PoseStream,
    PursuitStream,
    SmoothStream,
    Stream,
)
from crtk_drivers.motion.tool import PoseOutput
from crtk_drivers.move import Move, Outcome
from crtk_drivers.samples import Value, Vector, vector
from crtk_drivers.state import OperatingState
from crtk_drivers.status.deadman import Deadman
from crtk_drivers.status.procedures import close
from crtk_drivers.trajectory.profiles import JointProfile, LineProfile

logger = logging.getLogger(__name__)

SLOWEST_PACE = 0.05
"""Of real time, below which a trajectory counts as standing."""

REST_TIMEOUT = 5.0
"""Seconds in which a motion of the hardware's own must have come to its end after `stop`."""


ARRIVED = 1e-3
"""rad (m) from where a stream sent it within which a joint has arrived, when the stream falls silent."""


class MotionExecutor:
    """Executes the orders of one device. All methods but `abandon` belong to the I/O thread.

    Args:
        context: of the device.
        arbiter: where orders lie.
        following: watches that the joints are where they were sent.
    """

    def __init__(self, context: MotionContext, arbiter: Arbiter, following: FollowingWatch) -> None:
        self._context = context
        self._device = context.device
        self._where = context.where
        self._capabilities = context.capabilities
        self._arbiter = arbiter
        self._limiter = context.limiter
        self._inverse = context.inverse
        self._feedback = context.feedback
        self._board = context.board
        self._health = context.health
        self._stopping = context.stopping
        self._follows = following
        self._stream = Deadman(context.options.stream_timeout)
        self._following: Stream | None = None
        self._move: MoveExecution | None = None
        self._starting: Move | None = None
        self._freeing: Steps | None = None
        self._last_setpoint: Setpoint | None = None
        self._velocity: Order | None = None
        self._waiting: Order | None = None
        self._waits_since = self._waiting_fed = 0.0
        self._gravity: deque[bool] = deque(maxlen=1)
        self._stamp_ns = 0
        self._takes_poses = Mode.CARTESIAN_POSITION in self._capabilities.modes
        self._pursues = not self._takes_poses and self._capabilities.cartesian_limits is not None

    @property
    def rests(self) -> bool:
        """Whether nothing is carried out that makes setpoints, nor waits to be. From any thread."""
        doing = (self._move, self._following, self._starting, self._waiting, self._freeing)
        return all(one is None for one in doing)

    @property
    def is_free(self) -> bool:
        """Whether the device is in free drive. From any thread."""
        return self._freeing is not None

    def use_gravity_compensation(self, on: bool) -> None:
        """Switch it in the next cycle, in any state. From any thread."""
        self._gravity.append(on)

    def forget_settings(self) -> None:
        """Switch nothing on that was asked for while the link was being lost."""
        if self._gravity and self._gravity[0]:
            self._gravity.clear()

    def apply_settings(self) -> None:
        """Hand over to the device what was set since the last cycle.

        Raises:
            DeviceError: writing failed.
        """
        try:
            if self._gravity:
                self._device.use_gravity_compensation(self._gravity.popleft())
        except CommandRefused as refusal:
            self._board.refused(refusal)

    def step(self, now: float) -> str:
        """Do this cycle's part.

        Returns:
            the name of the stream that ended in this cycle because it fell silent, or "".

        Raises:
            DeviceFault: a joint does not follow.
            DeviceError: writing failed.
        """
        order = self._arbiter.take()
        try:
            self._watch()
            if self._waiting is not None:
                order = self._waited(order, now)
                if order is None:
                    return ""
            if order is not None:
                self._execute(order, now)
            elif self._move is not None:
                self._step_move(self._move, now)
            elif self._following is not None:
                return self._go_on(self._following, now)
            elif self._freeing is not None:
                next(self._freeing, None)
            elif self._stream.expired(now):
                return self._end_stream()
            elif self._velocity is not None:
                self._hold_velocity(self._velocity, now)
            elif self._last_setpoint is not None and self._capabilities.writes_every_cycle:
                self._write(self._last_setpoint)
        except (CommandRefused, MotionAborted) as error:
            self._interrupt(error)
        except CrtkError:
            raise
        except Exception as error:
            raise self._broken(order, error) from error
        return ""

    def _broken(self, order: Order | None, error: Exception) -> DeviceFault:
        """Refuse the command that raised what it must not, and return the fault that stops this device."""
        name = order.name if order is not None else self._health.stream or "motion"
        text = f"{type(error).__name__}: {error}"
        logger.error("%s: %s", self._where, name, exc_info=error)
        refusal = CommandRefused(
            name, Reason.INTERNAL_ERROR, text, where=self._where, remedy=REPORT
        )
        self._refuse(refusal, order)
        return DeviceFault(f"unexpected {text} in {name}", remedy=REPORT)

    def _refuse(self, refusal: CommandRefused, order: Order | None) -> None:
        refusal.stamp_ns = self._stamp_ns if order is None else order.stamp_ns
        self._board.refused(refusal)

    def _watch(self) -> None:
        """See that joints follow the positions that were sent, and that efforts do not run away with them.

        Raises:
            DeviceFault: a joint does not follow.
            CommandRefused: efforts drive a joint too fast, or out of its range.
        """
        last = self._last_setpoint
        if last is None:
            return
        measured, at = self._feedback.measured_state()
        if last.mode.kind is Kind.EFFORT:
            self._limiter.check_driven(self._health.stream or "servo", measured)
        trouble = self._follows.trouble(measured.position, at, self._device.pace)
        if trouble:
            raise DeviceFault(
                trouble,
                where=self._where,
                remedy="Look at what holds it, and whether commands arrive at it; then send enable.",
            )

    def _hold_velocity(self, wanted: Order, now: float) -> None:
        """Lower the velocity of a stream, between its commands, where the range of a joint comes near."""
        setpoint, last = wanted.setpoint, self._last_setpoint
        assert setpoint is not None
        limited = self._limiter.judge(
            wanted.name, setpoint, self._feedback.before(setpoint.mode, now)
        ).setpoint
        if last is None or limited.values.tolist() != last.values.tolist():
            self._send(Point(limited), now, wanted.stamp_ns)
        elif self._capabilities.writes_every_cycle:
            self._write(limited)

    def end(self, reason: str) -> None:
        """End all motion of ours because the device leaves ENABLED; the hardware is not told."""
        self.abandon(reason)
        self._move = self._starting = self._waiting = None
        self._forget_stream()
        self._feedback.hold()
        self._board.update(busy=False)
        freeing, self._freeing = self._freeing, None
        close(freeing, self._where)

    def abandon(self, reason: str) -> None:
        """Release those who wait for a move. From any thread."""
        running = self._move
        moves = [self._arbiter.clear(), self._starting, running.move if running else None]
        for move in moves:
            if move is not None:
                move.finish(Outcome.ABORTED, reason)

    def _execute(self, order: Order, now: float) -> None:
        if self._must_rest(order):
            self._end_for(order, now)
        else:
            self._begin(order, now)

    def _begin(self, order: Order, now: float) -> None:
        if order.is_stream:
            self._stream_on(order, now)
            return
        self._stamp_ns = order.stamp_ns
        self._forget_stream()
        self._starting, before = order.move, self._move
        self._supersede(order.name)
        if order.move is not None:
            self._start_move(order, now, before)
            self._starting = None
            if not isinstance(self._move, NativeMove) and self._move is not None:
                self._step_move(self._move, now)
        elif order.name == "hold":
            self._stopping.stop()
            self._feedback.hold()
        else:
            self._feedback.release()
            self._stopping.moves_again()
            self._freeing = self._device.free()

    def _stream_on(self, order: Order, now: float) -> None:
        (self._follow if self._goes_on_between(order) else self._servo)(order, now)

    def _goes_on_between(self, order: Order) -> bool:
        """Whether the stream of `order` goes on between its commands."""
        if order.level is Level.INTERPOLATE or order.target is not None:
            return True
        return order.displacement is not None and self._pursues

    def _is_native(self, goal: Goal) -> bool:
        """Whether the hardware plans the way to a goal."""
        name = "move_jp" if goal.pose is None else "move_cp"
        return name in self._capabilities.native_moves

    def _must_rest(self, order: Order) -> bool:
        """Whether the hardware has to come to rest before it can follow the setpoints of `order`."""
        makes_setpoints = order.is_stream or (
            order.goal is not None and not self._is_native(order.goal)
        )
        if not makes_setpoints:
            return False
        if isinstance(self._move, NativeMove) or self._freeing is not None:
            return True
        last = self._last_setpoint
        changes = last is not None and last.mode is not self._mode_of(order)
        return (self._capabilities.stops_between_modes and changes) or (
            last is None and not self._device.takes_setpoints
        )

    def _mode_of(self, order: Order) -> Mode:
        """Return the mode of what the stream or trajectory of `order` will send."""
        if order.setpoint is not None:
            return order.setpoint.mode
        if order.goal is not None and order.goal.pose is None:
            return Mode.JOINT_POSITION
        command, modes = find(order.name), self._capabilities.modes
        in_joints = mode_of(Space.JOINT, command.kind)
        is_cartesian = command.space is Space.CARTESIAN
        if is_cartesian and mode_of(Space.CARTESIAN, command.kind) in modes:
            return mode_of(Space.CARTESIAN, command.kind)
        by_twists = is_cartesian and self._capabilities.integrates_twists
        is_integrated = command.kind is Kind.VELOCITY and (by_twists or in_joints not in modes)
        return Mode.JOINT_POSITION if is_integrated else in_joints

    def _end_for(self, order: Order, now: float) -> None:
        """Bring the hardware to rest; `order` begins from there."""
        if order.is_stream and not self._goes_on_between(order):
            try:
                target = self._target(order)
                self._limiter.judge(order.name, target, self._feedback.before(target.mode))
            except CommandRefused as refusal:
                self._refuse(refusal, order)  # and what was going on goes on
                return
        is_free = self._freeing is not None
        self._starting = order.move
        self._supersede(order.name)
        if not is_free:
            self._stopping.stop()
        self._forget_stream()
        self._feedback.hold()
        if self._device.takes_setpoints:
            self._begin(order, now)
        else:
            self._waiting, self._waits_since, self._waiting_fed = order, now, now

    def _waited(self, newer: Order | None, now: float) -> Order | None:
        """Return the order that may begin now: one that need not wait, or the one that waited."""
        waiting, self._waiting = self._waiting, None
        if newer is not None:
            self._end_starting(Outcome.PREEMPTED, f"by {newer.name}")
            if newer.move is None:
                self._not_busy()
            if not newer.is_stream:
                return newer
            waiting = combined(waiting, newer)
        assert waiting is not None
        if newer is not None:
            self._waiting_fed = now
        if find(waiting.name).kind in (Kind.VELOCITY, Kind.EFFORT) and self._fell_silent(
            waiting, now
        ):
            self._health.stream_timeouts += 1
            return None
        if self._device.takes_setpoints:
            return waiting
        if now - self._waits_since < REST_TIMEOUT:
            self._waiting = waiting
            return None
        refusal = CommandRefused(
            waiting.name,
            Reason.TRANSITION_RUNNING,
            f"the hardware has not come to rest in {REST_TIMEOUT:g} s",
            where=self._where,
            remedy="Send hold, and look at the hardware.",
        )
        self._refuse(refusal, waiting)
        self._end_starting(Outcome.ABORTED, str(refusal))
        self._not_busy()
        return None

    def _fell_silent(self, waiting: Order, now: float) -> bool:
        """Whether the stream of an order that waits has ended meanwhile."""
        return now - self._waiting_fed > self._context.options.silence(waiting.level)

    def _end_starting(self, outcome: Outcome, reason: str) -> None:
        """End a move that has not begun."""
        starting, self._starting = self._starting, None
        if starting is not None:
            starting.finish(outcome, reason)

    def _servo(self, order: Order, now: float) -> None:
        try:
            target = self._target(order)
            if target.mode is Mode.JOINT_POSITION and not self._stream.armed:
                before, velocity, _ = self._feedback.motion(now)
                self._limiter.check_start(order.name, target.values, before, velocity)
            limited = self._context.limit(order.name, target, now)
        except CommandRefused as refusal:
            self._refuse(refusal, order)  # and what was going on goes on
            return
        self._supersede(order.name)
        self._send(Point(limited), now, order.stamp_ns)
        self._stream.feed(now)
        if limited.mode.kind is Kind.VELOCITY:
            self._velocity = order
        self._health.stream = order.name

    def _target(self, order: Order) -> Setpoint:
        if order.setpoint is not None:
            return order.setpoint
        if order.displacement is not None:
            command = find(order.name)
            pose = self._inverse.moved(command, order.displacement)
            return self._inverse.setpoint(command, pose)
        target = vector(self._feedback.reference_joints() + order.increment)
        return Setpoint(Mode.JOINT_POSITION, target)

    def _follow(self, order: Order, now: float) -> None:
        stream = self._following
        try:
            if stream is None or stream.name != order.name:
                stream = self._begin_stream(order.name, now)
            stream.feed(order, now)
        except CommandRefused as refusal:
            self._refuse(refusal, order)  # and what was going on goes on
            return
        if stream is not self._following:
            self._supersede(order.name)
            self._stream.disarm()
            self._following = stream
            self._health.stream = order.name
        self._stamp_ns = order.stamp_ns
        if order.level is Level.INTERPOLATE:
            self._latch_goals(stream.goals, order.stamp_ns)
        self._go_on(stream, now)

    def _latch_goals(self, goals: Mapping[str, Value], stamp_ns: int) -> None:
        self._feedback.latch(goals, stamp_ns)
        for goal in goals:
            self._board.latched(goal)

    def _begin_stream(self, name: str, now: float) -> Stream:
        return stream_class(find(name))(name, self._context, now)

    def _go_on(self, stream: Stream, now: float) -> str:
        point = stream.step(now)
        is_servo = find(stream.name).level is Level.SERVO
        sent = self._send_point(stream.name, point, now, self._stamp_ns if is_servo else 0)
        stream.sent(sent)
        return self._end_stream() if stream.is_over else ""

    def _pace(self, velocity: Vector, before: MoveExecution | None) -> float:
        """Return the pace at which a trajectory begins: that at which the joints move with `velocity`."""
        if isinstance(before, StreamedMove):
            return before.pace
        return 1.0 if velocity.any() else self._device.pace

    def _start_move(self, order: Order, now: float, before: MoveExecution | None) -> None:
        goal, move = order.goal, order.move
        assert goal is not None
        assert move is not None
        if self._is_native(goal):
            self._feedback.follow_device()
            self._stopping.moves_again()
            self._move = NativeMove(move, self._context, goal, self._missing(order))
            return
        missing = self._missing(order)
        position, velocity, acceleration = self._feedback.motion(now)
        pace = self._pace(velocity, before)
        # In the time of the trajectory, in which the motion that it goes on from is as much faster.
        share = 1.0 / pace if pace > SLOWEST_PACE else 0.0
        if goal.pose is None:
            limits = self._capabilities.move_limits or self._capabilities.limits
            speed, change = vector(velocity * share), vector(acceleration * share * share)
            profile = JointProfile(position, speed, change, order.joints, limits, goal.ratios)
            self._move = ProfileMove(
                move, self._context, profile, self._send_point, missing, now, pace
            )
            return
        command = find(order.name)
        tool = self._capabilities.line_limits or self._capabilities.cartesian_limits
        assert tool is not None
        line = LineProfile(
            self._inverse.pose(command),
            goal.pose,
            tool,
            goal.ratios,
            vector(self._feedback.reference_twist(now) * share),
            vector(self._feedback.reference_twist_change(now) * share * share),
        )
        output = PoseOutput(command, self._context, now, share)
        self._move = LineMove(
            move, self._context, line, output, self._send_point, missing, now, pace
        )

    def _missing(self, order: Order) -> Callable[[float], str | None]:
        """Return what says which joint is not yet at the goal of a move; see `MoveExecution`."""

        if self._capabilities.following is None:
            return lambda since: ""

        def missing(since: float) -> str | None:
            measured, at = self._feedback.measured_state()
            if at < since:
                return None
            return self._follows.missing(measured.position, order.joints)

        return missing

    def _step_move(self, move: MoveExecution, now: float) -> None:
        if move.step(now):
            self._finish_move(Outcome.REACHED)

    def _send_point(self, name: str, point: Point, now: float, stamp_ns: int = 0) -> Setpoint:
        setpoint = self._context.limit(name, point.setpoint, now)
        self._send(point.limited_to(setpoint), now, stamp_ns)
        return setpoint

    def _send(self, point: Point, now: float, stamp_ns: int = 0) -> None:
        self._write(point.setpoint)
        self._health.setpoints += 1
        self._last_setpoint = point.setpoint
        if point.setpoint.mode is Mode.JOINT_POSITION:
            self._follows.sent(point.setpoint.values, self._feedback.measured_joints(), now)
        else:
            self._follows.forget()
        self._feedback.sent(point, now, stamp_ns)

    def _write(self, setpoint: Setpoint) -> None:
        # The watchdog may have intervened since this cycle began.
        if self._board.status.state is OperatingState.ENABLED:
            self._stopping.moves_again()
            self._device.write(setpoint)

    def _supersede(self, name: str) -> None:
        freeing, self._freeing = self._freeing, None
        if freeing is not None:
            close(freeing, self._where)
            self._stopping.stop()
        self._following = self._velocity = None
        superseded, self._move = self._move, None
        if superseded is not None:
            superseded.move.finish(Outcome.PREEMPTED, f"by {name}")
        if find(name).level is not Level.MOVE:
            self._not_busy()

    def _finish_move(self, outcome: Outcome, reason: str = "") -> None:
        finished, self._move = self._move, None
        if finished is not None:
            finished.move.finish(outcome, reason)
        self._not_busy()

    def _interrupt(self, error: CommandRefused | MotionAborted) -> None:
        """What was going on cannot go on: stop, and release who waits for it."""
        starting, self._starting = self._starting, None
        if starting is not None:
            starting.finish(Outcome.ABORTED, str(error))
        name = "move" if self._move is None else self._move.move.name
        self._finish_move(Outcome.ABORTED, str(error))
        freeing, self._freeing = self._freeing, None
        close(freeing, self._where)
        if isinstance(error, CommandRefused):
            error.stamp_ns = self._stamp_ns
            self._board.refused(error)
        else:
            self._board.warned(f"{starting.name if starting else name}: {error}")
        self._forget_stream()
        self._stopping.stop()
        self._feedback.hold()

    def _forget_stream(self) -> None:
        self._stream.disarm()
        self._following = self._velocity = None
        self._health.stream = ""
        self._forget_setpoint()

    def _forget_setpoint(self) -> None:
        """What was sent last is not in force any more."""
        self._last_setpoint = None
        self._follows.forget()

    def _not_busy(self) -> None:
        """Announce that no move is running, unless the next one has been accepted."""
        with self._board.lock:
            if self._board.status.is_busy and not self._arbiter.move_waits:
                self._board.update(busy=False)

    def _tell_behind(self, stream: Stream) -> None:
        """Say of a stream that has fallen silent that the tool is not where it was sent."""
        behind = np.abs(stream.behind)
        if not behind.size or behind.max() < ARRIVED:
            return
        joint = self._capabilities.joints[int(behind.argmax())]
        refusal = CommandRefused(
            stream.name,
            Reason.STREAM_ENDED,
            f"no more commands came, and the tool has not arrived: {joint} is {behind.max():.3f} away",
            where=self._where,
            remedy="Go on sending the last pose until measured_cp is there, or use move_cp.",
        )
        self._refuse(refusal, None)

    def _end_stream(self) -> str:
        if self._following is not None:
            self._tell_behind(self._following)
        self._stream.disarm()
        self._following = self._velocity = None
        self._feedback.stream_ended()
        self._health.stream_timeouts += 1
        ended, self._health.stream = self._health.stream, ""
        last = self._last_setpoint
        if last is None or last.mode.kind is not Kind.POSITION:
            # A position is held by itself; a velocity or an effort would go on.
            self._forget_setpoint()
            self._stopping.stop()
            self._feedback.hold()
        return ended


def stream_class(command: Command) -> type[Stream]:
    """Return what carries out a stream of `command` that goes on between its commands."""
    if command.base_name == "servo_js":
        return MixedJointStream
    if command.base_name == "servo_cs":
        return MixedAxesStream
    moves = command.kind in (Kind.VELOCITY, Kind.EFFORT)
    if command.level is Level.SERVO:
        return HeldStream if moves else PursuitStream
    if command.space is Space.JOINT:
        return JointStream
    return SmoothStream if moves else PoseStream
