"""Motion in the I/O thread: takes orders, carries one of them out, ends what it replaces.

An order ends what was going on before it begins its own. A stream, or a move along a trajectory of ours, that
takes over from a motion of the hardware's own waits until that has come to its end. Without an activity the
position is held.
"""

from __future__ import annotations

import logging
from collections import deque

import numpy as np

from crtk_drivers.commands import Kind, Level, Space, find
from crtk_drivers.device import Mode, mode_of
from crtk_drivers.errors import (
    REPORT,
    CommandRefused,
    CrtkError,
    DeviceFault,
    MotionAborted,
    Reason,
)
from crtk_drivers.motion.activity import Activity, FreeDrive, Pending
from crtk_drivers.motion.arbiter import Arbiter, Order, combined
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.executions import NativeMove, begin_move, is_native
from crtk_drivers.motion.mixed import MixedAxesStream, MixedJointStream
from crtk_drivers.motion.move import Outcome
from crtk_drivers.motion.output import Output
from crtk_drivers.motion.streams import (
    DirectStream,
    HeldStream,
    JointStream,
    PoseStream,
    PursuitStream,
    SmoothStream,
    Stream,
    direct_target,
)

logger = logging.getLogger(__name__)

REST_TIMEOUT = 5.0
"""Seconds in which a motion of the hardware's own must have come to its end after `stop`."""

ARRIVED = 1e-3
"""rad (m) from where a stream sent it within which a joint has arrived, when the stream falls silent."""


class MotionExecutor:
    """Executes the orders of one device. Its methods belong to the I/O thread if they do not say otherwise.

    Args:
        context: of the device.
        arbiter: where orders lie.
    """

    def __init__(self, context: MotionContext, arbiter: Arbiter) -> None:
        self._context = context
        self._device = context.device
        self._where = context.where
        self._capabilities = context.capabilities
        self._arbiter = arbiter
        self._limiter = context.limiter
        self._feedback = context.feedback
        self._board = context.board
        self._health = context.health
        self._stopping = context.stopping
        self._output = Output(context)
        self._activity: Activity | None = None
        self._has_held = False  # since the newest sample
        self._gravity: deque[bool] = deque(maxlen=1)
        takes_poses = Mode.CARTESIAN_POSITION in self._capabilities.modes
        self._pursues = not takes_poses and self._capabilities.cartesian_limits is not None

    @property
    def rests(self) -> bool:
        """Whether nothing is carried out, nor waits to be. From any thread."""
        return self._activity is None

    @property
    def is_free(self) -> bool:
        """Whether the device is in free drive. From any thread."""
        return isinstance(self._activity, FreeDrive)

    def use_gravity_compensation(self, on: bool) -> None:
        """Switch gravity compensation in the next cycle, in any state. From any thread."""
        self._gravity.append(on)

    def forget_settings(self) -> None:
        """Do not switch gravity compensation on if that was asked for while the link was being lost."""
        if self._gravity and self._gravity[0]:
            self._gravity.clear()

    def apply_settings(self) -> None:
        """Switch gravity compensation as it was asked for since the last cycle.

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
        return self._step(self._arbiter.take(), now)

    def sample_came(self) -> None:
        """The hardware's next tick has begun: a setpoint may go out for it before it ends."""
        self._output.tick_taken = self._has_held = False

    def hurries(self, order: Order) -> bool:
        """Whether an order may be carried out between two samples. From any thread.

        Once in each tick of the hardware, a stop, and the next setpoint of a stream that the hardware takes
        as it is; what reckons its own setpoints keeps to the cycle.
        """
        if order.name == "hold":
            return not self._has_held
        if self._output.tick_taken or not isinstance(self._activity, DirectStream):
            return False
        return order.is_stream and self._stream_class(order) is DirectStream

    def hurry(self, now: float) -> None:
        """Carry out what need not wait for the next sample, and leave the rest; see `step`."""
        order = self._arbiter.take(self.hurries)
        if order is not None:
            if order.is_stream:  # also one that will be refused
                self._output.tick_taken = True
            self._step(order, now)

    def _step(self, order: Order | None, now: float) -> str:
        try:
            self._output.watch(now)
            order = self._still_meant(order, now)
            if isinstance(self._activity, Pending):
                order = self._waited(self._activity, order, now)
            activity = self._activity
            if order is not None:
                self._execute(order, now)
            elif activity is None:
                self._output.repeat()
            elif activity.step(now, self._output):
                return self._has_ended(activity)
        except (CommandRefused, MotionAborted) as error:
            self._interrupt(error, order)
        except CrtkError:
            raise
        except Exception as error:
            raise self._broken(order, error) from error
        return ""

    def _still_meant(self, order: Order | None, now: float) -> Order | None:
        """Refuse what waited until its stream was long over: its client may be gone, or want it no more."""
        if order is None or not order.is_stream:
            return order
        waited, options = self._arbiter.silent_for(now), self._context.options
        if waited <= max(options.silence(order.level), options.sample_timeout):
            return order
        remedy = "Send it again. The machine was busy: see the counters in diagnostics."
        self._turn_down(
            order, self._too_old(order, f"{waited:.3f} s for the I/O thread", remedy), now
        )
        return None

    def _too_old(self, order: Order, waited: str, remedy: str) -> CommandRefused:
        text = f"it waited {waited}, and no other came"
        return CommandRefused(order.name, Reason.TOO_OLD, text, where=self._where, remedy=remedy)

    def _broken(self, order: Order | None, error: Exception) -> DeviceFault:
        """Refuse the command that failed unexpectedly, and return the fault that stops the device."""
        name = order.name if order is not None else self._health.stream or "motion"
        text = f"{type(error).__name__}: {error}"
        logger.error("%s: %s", self._where, name, exc_info=error)
        refusal = CommandRefused(
            name, Reason.INTERNAL_ERROR, text, where=self._where, remedy=REPORT
        )
        self._refuse(refusal, order or self._activity)
        return DeviceFault(f"unexpected {text} in {name}", remedy=REPORT)

    def _refuse(self, refusal: CommandRefused, of: Order | Activity | None) -> None:
        self._board.refused(refusal.of(0 if of is None else of.stamp_ns))

    def end(self, reason: str) -> None:
        """End all motion of ours because the device leaves ENABLED; the hardware is not told."""
        self.abandon(reason)
        ended, self._activity = self._activity, None
        self._forget_stream()
        self._feedback.hold()
        self._board.update(busy=False)
        if ended is not None:
            ended.end(Outcome.ABORTED, reason)

    def follow_device(self) -> None:
        """Let the device move by itself, as by a service: what was sent before is not in force any more."""
        self._forget_stream()
        self._feedback.follow_device()

    def abandon(self, reason: str) -> None:
        """Release those who wait for a move. From any thread."""
        running = self._activity
        for move in (self._arbiter.clear(), running.move if running else None):
            if move is not None:
                move.finish(Outcome.ABORTED, reason)

    # --------------------------------------------------------------------------------------- orders

    def _execute(self, order: Order, now: float) -> None:
        if self._must_rest(order):
            self._end_for(order, now)
        else:
            self._begin(order, now)

    def _begin(self, order: Order, now: float) -> None:
        if order.is_stream:
            self._stream_on(order, now)
            return
        before = self._activity
        self._forget_stream()
        if order.move is not None:
            if not (isinstance(before, Pending) and before.order is order):
                self._replace(Pending(order, now, now), order.name)
            self._activity = move = begin_move(order, self._context, now, before)
            if not isinstance(move, NativeMove) and move.step(now, self._output):
                self._has_ended(move)
            return
        self._replace(None, order.name)
        if order.name == "hold":
            self._has_held = True
            self._stopping.stop()
            self._feedback.hold()
        else:
            self.follow_device()
            self._stopping.moves_again()
            self._stopping.let_go()
            self._activity = FreeDrive(order, self._device, self._where)

    def _stream_on(self, order: Order, now: float) -> None:
        kind, stream = self._stream_class(order), self._activity
        try:
            if not isinstance(stream, kind) or (
                stream.name != order.name and kind is not DirectStream
            ):
                stream = kind(order.name, self._context, now)
            stream.feed(order, now)
        except CommandRefused as refusal:
            if isinstance(self._activity, Pending):
                self._activity = None
            self._turn_down(order, refusal, now)
            return
        self._replace(stream, order.name)
        stream.stamp_ns = order.stamp_ns
        self._health.stream = order.name
        if order.level is Level.INTERPOLATE:
            self._context.latch(stream.goals, order.stamp_ns)
        stream.step(now, self._output)

    def _turn_down(self, order: Order, refusal: CommandRefused, now: float) -> None:
        """Refuse what was accepted; what was going on goes on, but for a `hold` that came before it."""
        self._refuse(refusal, order)
        if order.after_hold:
            self._begin(Order("hold"), now)
        elif self._activity is None or self._activity.move is None:
            self._not_busy()  # it may have taken the place of a move

    def _stream_class(self, order: Order) -> type[Stream]:
        """Return what carries out the stream of `order`."""
        if not self._goes_on_between(order):
            return DirectStream
        command = find(order.name)
        if command.base_name == "servo_js":
            return MixedJointStream
        if command.base_name == "servo_cs":
            return MixedAxesStream
        is_pose = command.kind in (Kind.POSITION, Kind.RELATIVE)
        if command.level is Level.SERVO:
            return PursuitStream if is_pose else HeldStream
        if command.space is Space.JOINT:
            return JointStream
        return PoseStream if is_pose else SmoothStream

    def _goes_on_between(self, order: Order) -> bool:
        """Whether the stream of `order` goes on between its commands."""
        if order.level is Level.INTERPOLATE or order.target is not None:
            return True
        return order.displacement is not None and self._pursues

    def _replace(self, activity: Activity | None, name: str) -> None:
        """Carry out `activity` from now on, by the command `name`; end another one that was going on."""
        before, self._activity = self._activity, activity
        if before is not None and before is not activity:
            before.end(Outcome.PREEMPTED, f"by {name}")
            if isinstance(before, FreeDrive):
                self._stopping.stop()
        if find(name).level is not Level.MOVE:
            self._not_busy()

    # ------------------------------------------------------------- rest, before another kind of motion

    def _must_rest(self, order: Order) -> bool:
        """Whether the hardware has to come to rest before it can follow the setpoints of `order`."""
        is_ours = order.goal is not None and not is_native(order, self._capabilities)
        if not (order.is_stream or is_ours):
            return False
        if isinstance(self._activity, NativeMove | FreeDrive):
            return True
        last = self._output.last
        if last is None:
            return not self._device.takes_setpoints
        return self._capabilities.stops_between_modes and last.mode is not self._mode_of(order)

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
                target = direct_target(order, self._context)
                self._limiter.judge(order.name, target, self._feedback.before(target.mode))
            except CommandRefused as refusal:
                self._turn_down(order, refusal, now)
                return
        was_free = self.is_free
        self._replace(Pending(order, now, now), order.name)
        if not was_free:
            self._stopping.stop()
        self._forget_stream()
        self._feedback.hold()
        if self._device.takes_setpoints:
            self._begin(order, now)

    def _waited(self, pending: Pending, newer: Order | None, now: float) -> Order | None:
        """Return the order that may begin now: one that need not wait, or the one that waited."""
        if newer is not None:
            if not newer.is_stream:
                return newer
            order = combined(pending.order, newer)
            pending = Pending(order, pending.since, now)
            self._replace(pending, newer.name)
        order = pending.order
        waited = now - pending.fed
        if order.is_stream and waited > self._context.options.silence(order.level):
            self._health.stream_timeouts += 1
            self._activity = None
            remedy = "Go on sending while it comes to rest."
            text = f"{waited:.3f} s for the hardware to come to rest"
            self._refuse(self._too_old(order, text, remedy), order)
            return None
        if self._device.takes_setpoints:
            return order
        if now - pending.since < REST_TIMEOUT:
            return None
        refusal = CommandRefused(
            order.name,
            Reason.TRANSITION_RUNNING,
            f"the hardware has not come to rest in {REST_TIMEOUT:g} s",
            where=self._where,
            remedy="Send hold, and look at the hardware.",
        )
        self._refuse(refusal, order)
        self._activity = None
        pending.end(Outcome.ABORTED, str(refusal))
        self._not_busy()
        return None

    # ---------------------------------------------------------------------------------------- ends

    def _has_ended(self, activity: Activity) -> str:
        """An activity has come to its own end; return its name if it is a stream, which fell silent."""
        self._activity = None
        if isinstance(activity, Stream):
            self._end_stream(activity)
            return activity.name
        activity.end(Outcome.REACHED)
        self._stopping.motion_ended()
        self._not_busy()
        return ""

    def _end_stream(self, stream: Stream) -> None:
        self._tell_behind(stream)
        self._feedback.stream_ended()
        self._health.stream_timeouts += 1
        self._health.stream = ""
        last = self._output.last
        if last is None or last.mode.kind is not Kind.POSITION:
            # A position is held by itself; a velocity or an effort would go on.
            self._output.forget()
            self._stopping.stop()
            self._feedback.hold()

    def _tell_behind(self, stream: Stream) -> None:
        """Tell, if it is so, that the tool is not where a stream sent it that has fallen silent."""
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
        self._refuse(refusal, stream)

    def _interrupt(self, error: CommandRefused | MotionAborted, order: Order | None) -> None:
        """What was going on cannot go on: stop, and release who waits for it, or for the order just taken."""
        ended, self._activity = self._activity, None
        if ended is not None:
            ended.end(Outcome.ABORTED, str(error))
        if order is not None and order.move is not None:
            order.move.finish(Outcome.ABORTED, str(error))
        self._not_busy()
        if isinstance(error, CommandRefused):
            self._refuse(error, ended or order)
        else:
            self._board.warned(f"{ended.name if ended else 'move'}: {error}")
        self._forget_stream()
        self._stopping.stop()
        self._feedback.hold()

    def _forget_stream(self) -> None:
        self._health.stream = ""
        self._output.forget()

    def _not_busy(self) -> None:
        """Announce that no move is running, unless the next one has been accepted."""
        with self._board.lock:
            if self._board.status.is_busy and self._arbiter.waiting_move is None:
                self._board.update(busy=False)
