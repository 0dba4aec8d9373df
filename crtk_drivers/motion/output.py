"""What goes out to the hardware of one device, through the last gate, and whether the joints follow it."""

from __future__ import annotations

import numpy as np

from crtk_drivers.commands import Kind
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.errors import DeviceFault
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.feedback import Active
from crtk_drivers.motion.following import FollowingWatch
from crtk_drivers.motion.point import Point
from crtk_drivers.samples import Vector
from crtk_drivers.state import OperatingState


class Output:
    """Sends the setpoints of one device. Belongs to the I/O thread.

    Args:
        context: of the device.

    Attributes:
        last: the setpoint that is in force; None if the hardware follows none of ours.
        tick_taken: nothing more may go out for the hardware's present tick before the next sample.
    """

    def __init__(self, context: MotionContext) -> None:
        self.last: Setpoint | None = None
        self.tick_taken = False
        self._context = context
        self._device = context.device
        self._feedback = context.feedback
        self._writes_every_cycle = context.capabilities.writes_every_cycle
        self._is_watched = context.capabilities.following is not None
        error = context.options.limits.following_error
        self._follows = FollowingWatch(context.capabilities, error)
        self._held: Active | None = None  # since a transition, and watched

    def send_limited(self, name: str, point: Point, now: float, stamp_ns: int = 0) -> Setpoint:
        """Send what the limits leave of a command's point; return the setpoint.

        Args:
            name: of the command.
            point: to be sent.
            now: monotonic seconds.
            stamp_ns: of the servo command that it comes from, 0 if that had none.

        Raises:
            CommandRefused: it may not be sent.
            DeviceError: writing failed.
        """
        setpoint = self._context.limit(name, point.setpoint, now)
        self.send(point.limited_to(setpoint), now, stamp_ns)
        return setpoint

    def send(self, point: Point, now: float, stamp_ns: int = 0) -> None:
        """Send a point that has passed the limits; see `send_limited`."""
        setpoint = point.setpoint
        self._write(setpoint)
        self.last = setpoint
        if setpoint.mode is Mode.JOINT_POSITION:
            self._follows.sent(setpoint.values, self._feedback.measured.position, now)
        else:
            self._follows.forget()
        self._feedback.sent(point, now, stamp_ns)
        self._context.health.setpoints += 1  # who sees it counted is told it

    def repeat(self) -> None:
        """Send the setpoint in force again, if there is one and the hardware wants it in each cycle."""
        if self._writes_every_cycle and self.last is not None:
            self._write(self.last)

    def forget(self) -> None:
        """What was sent last is not in force any more."""
        self.last = None
        self._follows.forget()

    def watch(self, now: float) -> None:
        """See that joints follow the positions that were sent, and that efforts do not run away with them.

        Args:
            now: monotonic seconds.

        Raises:
            DeviceFault: a joint does not follow.
            CommandRefused: efforts drive a joint too fast, or out of its range, or where nobody sees it.
        """
        context = self._context
        if self.last is None:
            if not self._is_held(now):
                return
        elif self.last.mode.kind is Kind.EFFORT:
            context.check_driven(context.health.stream or "servo", now)
        measured, at = self._feedback.measured_state()
        trouble = self._follows.trouble(measured.position, at, self._device.pace)
        if trouble:
            raise DeviceFault(
                trouble,
                where=context.where,
                remedy="Look at what holds it, and whether commands arrive at it; then send enable.",
            )
        if context.stopping.waits_for_lag(at) and self._follows.has_settled(measured.position):
            context.stopping.settled(at)

    def _is_held(self, now: float) -> bool:
        """Whether the joints are to stay where the last transition ended: nothing was sent since."""
        active = self._feedback.active
        if not active.was_seeded:
            return False
        if active is not self._held:
            self._held = active
            self._follows.hold(active.joints.position, now)
        return True

    def missing(self, goal: Vector, since: float) -> str | None:
        """Say which joint is not at the end (n,) of a move, in words; empty if all are there.

        None: there is no sample yet that was acquired after `since`, in monotonic seconds.
        """
        if not self._is_watched:
            return ""
        measured, at = self._feedback.measured_state()
        return None if at < since else self._follows.missing(measured.position, goal)

    def _write(self, setpoint: Setpoint) -> None:
        # The watchdog may have intervened since this cycle began.
        if self._context.board.status.state is OperatingState.ENABLED:
            self._context.stopping.moves_again()
            if not self._is_in_force(setpoint):
                lasts = setpoint.mode.kind is not Kind.POSITION and bool(setpoint.values.any())
                self._context.stopping.motion_sent(lasts=lasts)
            self.tick_taken = True
            self._device.write(setpoint)

    def _is_in_force(self, setpoint: Setpoint) -> bool:
        """Whether a setpoint was sent before, and is in force still."""
        last = self.last
        if last is None or last.mode is not setpoint.mode:
            return False
        return np.array_equal(last.values, setpoint.values)
