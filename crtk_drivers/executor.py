"""Motion in the I/O thread: takes orders, writes setpoints, follows moves, ends streams.

At any time one of four things is going on: nothing (the position is held), a servo stream, a move, or
free drive. An order ends what was going on before it begins its own.
"""

from __future__ import annotations

import numpy as np

from crtk_drivers.arbiter import Arbiter, Order
from crtk_drivers.board import StatusBoard
from crtk_drivers.commands import Kind
from crtk_drivers.device import Device, Mode, Setpoint, Steps
from crtk_drivers.errors import CommandRefused, MotionAborted
from crtk_drivers.feedback import Feedback
from crtk_drivers.health import HealthRecorder
from crtk_drivers.limits import SetpointLimiter
from crtk_drivers.motion import JointProfile
from crtk_drivers.moves import MoveExecution, NativeMove, Outcome, ProfileMove
from crtk_drivers.samples import JointState, vector
from crtk_drivers.watchdog import Deadman


class MotionExecutor:
    """Executes the orders of one device. All methods but `abandon` belong to the I/O thread.

    Args:
        device: written to.
        arbiter: where orders lie.
        limiter: the last gate before the wire.
        feedback: told what was sent.
        board: told when moves end, and what is refused.
        health: counts.
        stream_timeout: seconds after which a silent servo stream has ended.
    """

    def __init__(
        self,
        device: Device,
        arbiter: Arbiter,
        limiter: SetpointLimiter,
        feedback: Feedback,
        board: StatusBoard,
        health: HealthRecorder,
        stream_timeout: float,
    ) -> None:
        self._device = device
        self._capabilities = device.capabilities
        self._arbiter = arbiter
        self._limiter = limiter
        self._feedback = feedback
        self._board = board
        self._health = health
        self._stream = Deadman(stream_timeout)
        self._move: MoveExecution | None = None
        self._freeing: Steps | None = None
        self._last_setpoint: Setpoint | None = None

    def step(self, now: float) -> str:
        """Do this cycle's part.

        Returns:
            the name of the servo stream that ended in this cycle because it fell silent, or "".

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
            elif self._freeing is not None:
                next(self._freeing, None)
            elif self._stream.expired(now):
                return self._end_stream()
            elif self._last_setpoint is not None and self._capabilities.writes_every_cycle:
                self._device.write(self._last_setpoint)
        except CommandRefused as refusal:
            self._board.refused(refusal)
        except MotionAborted as error:
            self._device.stop()
            self._finish_move(Outcome.ABORTED, str(error))
            self._board.warned(str(error))
        return ""

    def end(self, reason: str) -> None:
        """End all motion of ours because the device leaves ENABLED; the hardware is not told."""
        self.abandon(reason)
        self._move = None
        freeing, self._freeing = self._freeing, None
        if freeing is not None:
            freeing.close()
        self._stream.disarm()
        self._health.stream = ""
        self._last_setpoint = None
        self._board.update(busy=False)

    def abandon(self, reason: str) -> None:
        """Release those who wait for a move. From any thread."""
        waiting, running = self._arbiter.clear(), self._move
        for move in (waiting, running.move if running is not None else None):
            if move is not None:
                move.finish(Outcome.ABORTED, reason)

    def _execute(self, order: Order, now: float) -> None:
        if order.is_servo:
            setpoint = order.setpoint
            if setpoint is None:
                target = vector(self._feedback.reference_joints() + order.increment)
                setpoint = Setpoint(Mode.JOINT_POSITION, target)
            self._supersede(order.name)
            self._write(order.name, setpoint)
            self._stream.feed(now)
            self._health.stream = order.name
            return
        self._stream.disarm()
        self._health.stream = ""
        self._last_setpoint = None
        self._supersede(order.name)
        if order.move is not None:
            self._start_move(order, now)
        elif order.name == "hold":
            self._device.stop()
            self._feedback.hold()
        else:
            self._freeing = self._device.free()
            self._feedback.release()

    def _start_move(self, order: Order, now: float) -> None:
        assert order.goal is not None
        assert order.move is not None
        native = "move_jp" if order.goal.pose is None else "move_cp"
        try:
            if native in self._capabilities.native_moves:
                self._feedback.follow_device()
                self._move = NativeMove(order.move, self._device, order.goal)
                return
            start = self._feedback.joint_setpoint()
            at_rest = vector(np.zeros(order.joints.size))
            profile = JointProfile(
                self._feedback.reference_joints(),
                start.velocity if start.velocity.size else at_rest,
                order.joints,
                self._capabilities.limits,
                order.goal.ratio,
            )
        except MotionAborted as error:
            order.move.finish(Outcome.ABORTED, str(error))
            raise
        period = 1.0 / self._capabilities.rate
        self._move = ProfileMove(order.move, profile, self._send_point, now, period)

    def _send_point(self, name: str, point: JointState) -> None:
        self._write(name, Setpoint(Mode.JOINT_POSITION, point.position))
        self._feedback.trajectory(point)

    def _write(self, name: str, setpoint: Setpoint) -> None:
        limited = self._limiter.limit(name, setpoint, self._feedback.before(setpoint.mode))
        self._device.write(limited)
        self._health.setpoints += 1
        self._last_setpoint = limited
        self._feedback.sent(limited)

    def _supersede(self, name: str) -> None:
        freeing, self._freeing = self._freeing, None
        if freeing is not None:
            freeing.close()
            self._device.stop()
        superseded, self._move = self._move, None
        if superseded is not None:
            superseded.move.finish(Outcome.PREEMPTED, f"by {name}")
            if not name.startswith("move_"):
                self._board.update(busy=False)

    def _finish_move(self, outcome: Outcome, reason: str = "") -> None:
        finished, self._move = self._move, None
        if finished is not None:
            finished.move.finish(outcome, reason)
        self._board.update(busy=False)

    def _end_stream(self) -> str:
        self._stream.disarm()
        self._health.stream_timeouts += 1
        ended, self._health.stream = self._health.stream, ""
        last = self._last_setpoint
        if last is None or last.mode.kind is not Kind.POSITION:
            # A position is held by itself; a velocity or an effort would go on.
            self._last_setpoint = None
            self._device.stop()
            self._feedback.hold()
        return ended
