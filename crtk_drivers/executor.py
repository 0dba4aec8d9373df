"""Motion in the I/O thread: takes orders, writes setpoints, follows moves, ends streams.

At any time one of five things is going on: nothing (the position is held), a servo stream, a stream
that goes on between its commands, a move, or free drive. An order ends what was going on before it begins
its own.
"""

from __future__ import annotations

from crtk_drivers.arbiter import Arbiter, Order
from crtk_drivers.board import StatusBoard
from crtk_drivers.commands import COMMANDS, Kind, Level, Space
from crtk_drivers.device import Device, Mode, Setpoint, Steps
from crtk_drivers.errors import CommandRefused, MotionAborted
from crtk_drivers.feedback import Feedback
from crtk_drivers.health import HealthRecorder
from crtk_drivers.limits import SetpointLimiter
from crtk_drivers.moves import Move, MoveExecution, NativeMove, Outcome, ProfileMove
from crtk_drivers.procedures import close
from crtk_drivers.profiles import JointProfile, Ratios
from crtk_drivers.reach import Reach
from crtk_drivers.samples import EMPTY, JointState, Vector, vector
from crtk_drivers.state import OperatingState
from crtk_drivers.streams import JointStream, PoseStream, ResolvedStream, Stream, TwistStream
from crtk_drivers.watchdog import Deadman


class MotionExecutor:
    """Executes the orders of one device. All methods but `abandon` belong to the I/O thread.

    Args:
        device: written to.
        where: the device, for messages.
        arbiter: where orders lie.
        limiter: the last gate before the wire.
        reach: from poses to joints.
        feedback: told what was sent.
        board: told when moves end, and what is refused.
        health: counts.
        stream_timeout: seconds after which a silent servo stream has ended.
        interpolate_timeout: the same for an interpolated stream.
    """

    def __init__(
        self,
        device: Device,
        where: str,
        arbiter: Arbiter,
        limiter: SetpointLimiter,
        reach: Reach,
        feedback: Feedback,
        board: StatusBoard,
        health: HealthRecorder,
        stream_timeout: float,
        interpolate_timeout: float,
    ) -> None:
        self._device = device
        self._where = where
        self._capabilities = device.capabilities
        self._arbiter = arbiter
        self._limiter = limiter
        self._reach = reach
        self._feedback = feedback
        self._board = board
        self._health = health
        self._stream = Deadman(stream_timeout)
        self._interpolate_timeout = interpolate_timeout
        self._following: Stream | None = None
        self._move: MoveExecution | None = None
        self._starting: Move | None = None
        self._freeing: Steps | None = None
        self._last_setpoint: Setpoint | None = None

    def step(self, now: float) -> str:
        """Do this cycle's part.

        Returns:
            the name of the stream that ended in this cycle because it fell silent, or "".

        Raises:
            DeviceError: writing failed.
        """
        order = self._arbiter.take()
        try:
            if order is not None:
                self._execute(order, now)
            elif self._move is not None:
                if self._move.step(now):
                    self._finish_move(Outcome.REACHED)
            elif self._following is not None:
                return self._go_on(self._following, now)
            elif self._freeing is not None:
                next(self._freeing, None)
            elif self._stream.expired(now):
                return self._end_stream()
            elif self._last_setpoint is not None and self._capabilities.writes_every_cycle:
                self._write(self._last_setpoint)
        except (CommandRefused, MotionAborted) as error:
            self._interrupt(error)
        return ""

    def end(self, reason: str) -> None:
        """End all motion of ours because the device leaves ENABLED; the hardware is not told."""
        self.abandon(reason)
        self._move = self._starting = None
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
        if order.is_stream:
            goes_on = order.level is Level.INTERPOLATE or order.target is not None
            follow = self._follow if goes_on else self._servo
            follow(order, now)
            return
        self._forget_stream()
        self._starting = order.move
        self._supersede(order.name)
        if order.move is not None:
            self._start_move(order, now)
            self._starting = None
            if isinstance(self._move, ProfileMove) and self._move.step(now):
                self._finish_move(Outcome.REACHED)
        elif order.name == "hold":
            self._device.stop()
            self._feedback.hold()
        else:
            self._feedback.release()
            self._freeing = self._device.free()

    def _servo(self, order: Order, now: float) -> None:
        try:
            limited = self._limit(order.name, self._target(order), now)
        except CommandRefused as refusal:
            self._board.refused(refusal)  # and what was going on goes on
            return
        self._supersede(order.name)
        self._send(limited)
        self._stream.feed(now)
        self._health.stream = order.name

    def _target(self, order: Order) -> Setpoint:
        if order.setpoint is not None:
            return order.setpoint
        if order.displacement is not None:
            command = COMMANDS[order.name]
            pose = self._reach.moved(command, order.displacement)
            return self._reach.setpoint(command, pose)
        target = vector(self._feedback.reference_joints() + order.increment)
        return Setpoint(Mode.JOINT_POSITION, target)

    def _follow(self, order: Order, now: float) -> None:
        stream = self._following
        try:
            if stream is None or stream.name != order.name:
                stream = self._begin_stream(order.name, now)
            stream.feed(order, now)
        except CommandRefused as refusal:
            self._board.refused(refusal)  # and what was going on goes on
            return
        if stream is not self._following:
            self._supersede(order.name)
            self._stream.disarm()
            self._following = stream
            self._health.stream = order.name
        goals = stream.goals
        self._feedback.accept_goals(goals)
        for goal in goals:
            self._board.goal_accepted(goal)
        self._go_on(stream, now)

    def _begin_stream(self, name: str, now: float) -> Stream:
        command, timeout = COMMANDS[name], self._interpolate_timeout
        if command.level is Level.SERVO:
            timeout = self._stream.timeout
            return ResolvedStream(name, self._device, self._feedback, timeout, now)
        if command.space is Space.JOINT:
            return JointStream(name, self._device, self._feedback, self._clamp, timeout, now)
        if command.kind is Kind.VELOCITY:
            return TwistStream(name, self._device, self._feedback, timeout, now)
        return PoseStream(name, self._device, self._feedback, self._reach, timeout, now)

    def _clamp(self, name: str, positions: Vector, before: Vector) -> Vector:
        clamped, warning = self._limiter.into_range(name, positions, before)
        if warning:
            self._warn_clamped(name, warning)
        return clamped

    def _go_on(self, stream: Stream, now: float) -> str:
        point = stream.step(now)
        setpoint = self._limit(stream.name, point.setpoint, now)
        self._send(setpoint, point.joints, point.acceleration, point.twist)
        return self._end_stream() if stream.is_over else ""

    def _start_move(self, order: Order, now: float) -> None:
        assert order.goal is not None
        assert order.move is not None
        native = "move_jp" if order.goal.pose is None else "move_cp"
        if native in self._capabilities.native_moves:
            self._feedback.follow_device()
            self._move = NativeMove(order.move, self._device, order.goal)
            return
        profile = JointProfile(
            *self._feedback.motion(),
            order.joints,
            self._capabilities.limits,
            Ratios.both(order.goal.ratio),
        )
        period = 1.0 / self._capabilities.rate
        self._move = ProfileMove(order.move, profile, self._send_point, now, period)

    def _send_point(self, name: str, point: JointState, acceleration: Vector, now: float) -> None:
        setpoint = self._limit(name, Setpoint(Mode.JOINT_POSITION, point.position), now)
        self._send(setpoint, point, acceleration)

    def _limit(self, name: str, setpoint: Setpoint, now: float) -> Setpoint:
        before = self._feedback.before(setpoint.mode)
        limited = self._limiter.limit(name, setpoint, before, now)
        if limited.warning:
            self._warn_clamped(name, limited.warning)
        return limited.setpoint

    def _warn_clamped(self, name: str, warning: str) -> None:
        self._health.clamped += 1
        self._board.warned(f"{name}: {warning}")

    def _send(
        self,
        setpoint: Setpoint,
        joints: JointState | None = None,
        acceleration: Vector = EMPTY,
        twist: Vector = EMPTY,
    ) -> None:
        self._write(setpoint)
        self._health.setpoints += 1
        self._last_setpoint = setpoint
        self._feedback.sent(setpoint, joints, acceleration, twist)

    def _write(self, setpoint: Setpoint) -> None:
        # The watchdog may have intervened since this cycle began.
        if self._board.status.state is OperatingState.ENABLED:
            self._device.write(setpoint)

    def _supersede(self, name: str) -> None:
        freeing, self._freeing = self._freeing, None
        if freeing is not None:
            close(freeing, self._where)
            self._device.stop()
        self._following = None
        superseded, self._move = self._move, None
        if superseded is not None:
            superseded.move.finish(Outcome.PREEMPTED, f"by {name}")
        if not name.startswith("move_"):
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
            self._board.refused(error)
        else:
            self._board.warned(f"{starting.name if starting else name}: {error}")
        if self._following is not None:
            self._forget_stream()
        self._device.stop()
        self._feedback.hold()

    def _forget_stream(self) -> None:
        self._stream.disarm()
        self._following = None
        self._health.stream = ""
        self._last_setpoint = None

    def _not_busy(self) -> None:
        """Announce that no move is running, unless the next one has been accepted."""
        with self._board.lock:
            if self._board.status.is_busy and not self._arbiter.move_waits:
                self._board.update(busy=False)

    def _end_stream(self) -> str:
        self._stream.disarm()
        self._following = None
        self._health.stream_timeouts += 1
        ended, self._health.stream = self._health.stream, ""
        last = self._last_setpoint
        if last is None or last.mode.kind is not Kind.POSITION:
            # A position is held by itself; a velocity or an effort would go on.
            self._last_setpoint = None
            self._device.stop()
            self._feedback.hold()
        return ended
