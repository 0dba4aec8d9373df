"""The order in which motions may follow one another on the controller.

Each kind of motion runs in a thread of its own in the control program, and two of them at once make the
controller abort the program. So before another kind starts, the present one is brought to rest and
ended. The library's blocking stops last as long as the arm takes to stop, and during them nothing feeds
the robot-side watchdog; the arm is therefore slowed down first, by commands that do not block, and
the blocking stop is called on an arm that stands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from crtk_driver_ur.control_options import MotionOptions
from crtk_driver_ur.control_requests import CallError
from crtk_driver_ur.library.calls import LibraryCalls, LibraryError
from crtk_driver_ur.library.packets import Event, EventKind, MotionCommand, MotionKind

STREAMED = frozenset({MotionKind.SERVO_JOINT, MotionKind.SPEED_JOINT, MotionKind.SPEED_CARTESIAN})
"""Kinds that are commanded again and again and change their target without a stop between."""
MOVES = frozenset({MotionKind.MOVE_JOINT, MotionKind.MOVE_LINEAR})
FREE: Mapping[MotionKind, tuple[str, str]] = MappingProxyType(
    {
        MotionKind.FREEDRIVE: ("freedriveMode", "endFreedriveMode"),
        MotionKind.TEACH_MODE: ("teachMode", "endTeachMode"),
    }
)
"""Kinds in which the arm gives way, with the library's methods that begin and end them."""

STOP_TIMEOUT = 5.0
"""A move that has not stopped after so many seconds is reported."""
ASYNC_START = 0.3
"""An asynchronous operation that shows no new number after so many seconds has ended already."""
SETTLE_MARGIN = 0.1
"""Seconds for the last of a motion to die away after its nominal end."""
LONGEST_STEP = 0.02
"""Seconds of motion at most that one position of a stream may ask for, however late it is."""
CATCH_UP = 0.8
"""Share of the speed that a joint may have at which it makes up for what waited: what is sent comes unevenly,
and where servoJ would go faster than a joint can, the controller stops protectively."""
STILL = 1e-5
"""Change of a servo target, in rad, that counts as none."""
_ENDING = CallError(
    "motion",
    "the arm could not be brought to rest, and the control program is being ended",
    "Wait for that, then enable again.",
)


class MotionSequencer:
    """Carries out the newest motion command, stopping whatever runs before it.

    Args:
        calls: the control interface of the library, guarded.
        options: how.
        report: receives the events.
    """

    def __init__(
        self, calls: LibraryCalls, options: MotionOptions, report: Callable[[Event], None]
    ) -> None:
        self._calls = calls
        self._options = options
        self._report = report
        self.motion = MotionKind.NONE
        self.sequence = 0
        self.settling = False
        self._command = MotionCommand(0, MotionKind.NONE)
        self._target: tuple[float, ...] = ()
        self._stepped_at = 0.0
        self._pending: MotionCommand | None = None
        self._commanded_at = 0.0
        self._moved_at = 0.0
        self._settled_at = 0.0
        self._settling_since = 0.0
        self._operation = 0
        self._fed_at = 0.0
        self._program_ran = False
        self._starving = False

    @property
    def progress(self) -> int:
        """The library's progress number of a move, else 0."""
        if self.motion in MOVES and not self.settling:
            return int(self._status().progress())
        return 0

    def command(self, command: MotionCommand, now: float) -> None:
        """Take a new command; it replaces any that has not begun, and ends a move.

        None is taken while the watchdog is left to end the program: it would be fed by it. A stop is answered
        by that end.
        """
        if self._starving:
            if command.kind is not MotionKind.STOP:
                self._report(Event(EventKind.MOTION_FAILED, command.sequence, _ENDING))
            return
        if self.motion in MOVES and not self.settling:
            self._report(Event(EventKind.INTERRUPTED, self.sequence))
        if self._pending is not None and self._pending.kind is not MotionKind.STOP:
            self._report(Event(EventKind.INTERRUPTED, self._pending.sequence))
        self._pending = None
        try:
            if self.motion is MotionKind.NONE:
                self._start(command, now)
            elif command.kind is self.motion and command.kind in STREAMED:
                self.settling = False
                self._stream(command, now)
            else:
                self._pending = command
                if not self.settling:
                    self._settle(now)
        except LibraryError as error:
            self._fail(command.sequence, error)

    def tick(self, now: float) -> None:
        """Advance: see the end of a move, finish a stop, let a speed expire, feed the watchdog."""
        try:
            if not self._watch_program():
                return
            if self.settling:
                self._finish_settling(now)
            elif self.motion in MOVES:
                self._watch_move(now)
            elif self.motion is MotionKind.SERVO_JOINT and self._command.values != self._target:
                self._stream(self._command._replace(values=self._target), now)
            elif (
                self.motion in (MotionKind.SPEED_JOINT, MotionKind.SPEED_CARTESIAN)
                and now > self._commanded_at + self._command.second
            ):
                self._report(Event(EventKind.SPEED_EXPIRED, self.sequence))
                self._settle(now)
            if not self._starving and now - self._fed_at >= self._options.feed_period:
                self._feed(now)
        except LibraryError as error:
            self._fail(self.sequence, error)

    def halt(self) -> None:
        """End all motion by blocking calls, as this process is about to end."""
        options = self._options
        stops: dict[MotionKind, tuple[str, tuple[Any, ...]]] = {
            MotionKind.SERVO_JOINT: ("servoStop", (options.linear_deceleration,)),
            MotionKind.SPEED_JOINT: ("speedStop", (options.joint_deceleration,)),
            MotionKind.SPEED_CARTESIAN: ("speedStop", (options.linear_deceleration,)),
            MotionKind.MOVE_JOINT: ("stopJ", (options.joint_deceleration, False)),
            MotionKind.MOVE_LINEAR: ("stopJ", (options.joint_deceleration, False)),
            **{kind: (end, ()) for kind, (_, end) in FREE.items()},
        }
        if self.motion in stops:
            name, arguments = stops[self.motion]
            self._calls.call(name, *arguments)
        self.motion = MotionKind.NONE

    def clear_command(self) -> None:
        """Take the last command of a stream out of the controller's register.

        It stays there when the control program ends, and the next one would carry it out at once.
        While no program runs, ur_rtde's answer to a kick of the watchdog is to clear it, and False.
        """
        self._calls.call("kickWatchdog")

    def program_restarted(self) -> None:
        """A new control program runs: nothing of the old one is left."""
        self.motion = MotionKind.NONE
        self.settling = False
        self._pending = None
        self._program_ran = True
        self._starving = False

    # Beginning and continuing

    def _start(self, command: MotionCommand, now: float) -> None:
        kind, values = command.kind, list(command.values)
        if kind is MotionKind.STOP or kind is MotionKind.NONE:
            self.sequence = command.sequence
            self._report(Event(EventKind.STOPPED, command.sequence))
            return
        if kind in STREAMED:
            # Adopted first: if the library fails half-way, the motion may have begun all the same.
            self._adopt(command, now)
            self._moved_at = self._stepped_at = now
            self._target = command.values
            self._send(command)
            return
        if kind in MOVES:
            self._operation = self._status().operationId()
            name = "moveJ" if kind is MotionKind.MOVE_JOINT else "moveL"
            self._calls.command(name, values, command.first, command.second, True)
        else:
            self._calls.command(FREE[kind][0])
        self._adopt(command, now)

    def _adopt(self, command: MotionCommand, now: float) -> None:
        self.motion, self.sequence = command.kind, command.sequence
        self._command, self._commanded_at = command, now
        self._fed_at = now

    def _stream(self, command: MotionCommand, now: float) -> None:
        if command.kind is MotionKind.SERVO_JOINT:
            before, self._target = self._target, command.values
            command = command._replace(values=self._step(before, now))
            change = max(
                abs(a - b) for a, b in zip(command.values, self._command.values, strict=True)
            )
            if change > STILL:
                self._moved_at = now
        self._send(command)
        self._adopt(command, now)

    def _step(self, before: Sequence[float], now: float) -> tuple[float, ...]:
        """Return the way to the target that joints go since the last step: what waited here is no jump.

        They go as fast as the target does since the one `before`, if that is faster than they catch up.
        """
        elapsed, self._stepped_at = min(now - self._stepped_at, LONGEST_STEP), now
        return tuple(
            _approach(sent, wanted, speed * elapsed, abs(wanted - last))
            for sent, wanted, last, speed in zip(
                self._command.values, self._target, before, self._options.joint_speeds, strict=True
            )
        )

    def _send(self, command: MotionCommand) -> None:
        options = self._options
        values = list(command.values)
        if command.kind is MotionKind.SERVO_JOINT:
            # The script ignores speed and acceleration; the library wants them in range.
            self._calls.realtime(
                "servoJ", values, 0.0, 0.0, options.period, options.lookahead, options.gain
            )
        else:
            name = "speedJ" if command.kind is MotionKind.SPEED_JOINT else "speedL"
            self._calls.realtime(name, values, command.first, options.period)

    def _feed(self, now: float) -> None:
        # A kick in the same control cycle would overwrite the last target, so streams repeat it.
        if self.motion in STREAMED:
            self._send(self._command)
        else:
            self._calls.realtime("kickWatchdog")
        self._fed_at = now

    # Ending

    def _settle(self, now: float) -> None:
        """Begin to bring the present motion to rest, without blocking."""
        options = self._options
        self.settling = True
        self._settling_since = now
        self._settled_at = now
        if self.motion is MotionKind.SERVO_JOINT:
            self._settled_at = max(now, self._moved_at + options.lookahead + SETTLE_MARGIN)
        elif self.motion in STREAMED:
            joint = self.motion is MotionKind.SPEED_JOINT
            deceleration = options.joint_deceleration if joint else options.linear_deceleration
            fastest = max(map(abs, self._command.values))
            zero = self._command._replace(values=(0.0,) * 6, first=deceleration)
            self._send(zero)
            self._command = zero
            self._fed_at = now
            self._settled_at = now + fastest / deceleration + SETTLE_MARGIN
        elif self.motion in MOVES:
            self._operation = self._status().operationId()
            self._calls.blocking("stopJ", options.joint_deceleration, True)

    def _finish_settling(self, now: float) -> None:
        if now < self._settled_at:
            return
        options = self._options
        if self.motion is MotionKind.SERVO_JOINT:
            self._calls.command("servoStop", options.linear_deceleration)
        elif self.motion is MotionKind.SPEED_JOINT:
            self._calls.command("speedStop", options.joint_deceleration)
        elif self.motion is MotionKind.SPEED_CARTESIAN:
            self._calls.command("speedStop", options.linear_deceleration)
        elif self.motion in FREE:
            self._calls.command(FREE[self.motion][1])
        elif not self._operation_ended(now):
            if now > self._settling_since + STOP_TIMEOUT:
                raise LibraryError(
                    CallError("stopJ", "the move has not stopped", "Disable the arm.")
                )
            return
        self.motion = MotionKind.NONE
        self.settling = False
        pending, self._pending = self._pending, None
        if pending is None:
            self._report(Event(EventKind.STOPPED, self.sequence))
        else:
            self._start(pending, now)

    def _operation_ended(self, now: float) -> bool:
        """Whether the operation begun last by an asynchronous call has come and gone."""
        status = self._status()
        if status.isAsyncOperationRunning():
            return False
        begun = status.operationId() != self._operation
        since = self._settling_since if self.settling else self._commanded_at
        return begun or now > since + ASYNC_START

    def _watch_move(self, now: float) -> None:
        if self._operation_ended(now):
            self.motion = MotionKind.NONE
            self._report(Event(EventKind.MOVE_DONE, self.sequence))

    def _watch_program(self) -> bool:
        """Whether the control program runs; its end is reported once."""
        running = bool(self._calls.read("isProgramRunning"))
        if self._program_ran and not running:
            self._starving = False
            self.clear_command()
            if self._pending is not None:
                self._report(Event(EventKind.INTERRUPTED, self._pending.sequence))
            self.motion = MotionKind.NONE
            self.settling = False
            self._pending = None
            text = "the control program has stopped on the controller"
            hint = "Look for a protective stop or a message on the teach pendant, then enable."
            self._report(
                Event(
                    EventKind.PROGRAM_STOPPED,
                    self.sequence,
                    CallError("isProgramRunning", text, hint),
                )
            )
        self._program_ran = running
        return running

    def _fail(self, sequence: int, error: LibraryError) -> None:
        """Report, and bring the arm to rest: gently if the library still can, else by starving
        the robot-side watchdog, which ends the control program."""
        self._report(Event(EventKind.MOTION_FAILED, sequence, error.error))
        self._pending = None
        if self.motion is MotionKind.NONE:
            return
        if not self.settling:
            try:
                self._settle(self._commanded_at)
            except LibraryError as second:
                self._report(Event(EventKind.MOTION_FAILED, sequence, second.error))
            else:
                return
        self.motion = MotionKind.NONE
        self.settling = False
        self._starving = True

    def _status(self) -> Any:
        return self._calls.read("getAsyncOperationProgressEx")


def _approach(sent: float, wanted: float, farthest: float, advance: float) -> float:
    step = max(CATCH_UP * farthest, min(farthest, advance))
    return sent + max(-step, min(step, wanted - sent))
