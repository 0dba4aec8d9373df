"""State commands while they are carried out: a device's procedure, stepped once a cycle, with a bound.

`accept` judges in the client's thread; `step` works in the I/O thread. What a procedure raises decides
where it ends: `CommandRefused` leaves the state as it was, `ConnectionLost` means that there is nobody to
talk to, and any other error of ours is FAULT with the reason. Before a procedure begins, motion is stopped.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

from crtk_drivers.device import Steps
from crtk_drivers.errors import (
    REPORT,
    CommandRefused,
    ConnectionLost,
    CrtkError,
    Reason,
    unexpected,
)
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.state import (
    HOMING_COMMANDS,
    HOMING_STATES,
    TRANSITIONS,
    OperatingState,
    StateCommand,
    Status,
    target_of,
)
from crtk_drivers.status.procedures import Procedure

logger = logging.getLogger(__name__)

_DONE_WHERE_REACHED = frozenset({StateCommand.ENABLE, StateCommand.PAUSE, StateCommand.RESUME})
"""State commands that have nothing to do in the state that they lead to.

Not `disable`: after a connection DISABLED says nothing of the hardware, and power may be on. `home` has
nothing to do on a device that is homed, `unhome` on one that is not."""


_ENABLING = frozenset({StateCommand.ENABLE, StateCommand.RESUME})

_PAUSED_IN = frozenset(
    {StateCommand.PAUSE, StateCommand.RESUME, StateCommand.HOME, StateCommand.UNHOME}
)
"""State commands that `pause` ends: those in which there is something to pause."""


def _ends(command: StateCommand, running: StateCommand) -> bool:
    """Whether a state command takes the place of one that is being carried out."""
    is_stop = command is StateCommand.PAUSE and running in _PAUSED_IN
    return command is StateCommand.DISABLE or is_stop


@dataclass(slots=True)
class _Running:
    command: StateCommand
    target: OperatingState
    stamp_ns: int
    stops: bool = False
    procedure: Procedure | None = None
    ended: float | None = None
    """When the procedure ended, in monotonic seconds."""


class Transitions:
    """Carries out the state commands of one device.

    Args:
        context: of the device.
        end_motion: called before a procedure begins, with the name of its command.
    """

    def __init__(self, context: MotionContext, end_motion: Callable[[str], None]) -> None:
        device = context.device
        self._device = device
        self._needs_homing = device.capabilities.needs_homing
        self._moving = _ENABLING if device.capabilities.enable_moves else frozenset()
        self._timeout = device.capabilities.transition_timeout
        self._where = context.where
        self._board = context.board
        self._end_motion = end_motion
        self._stopping = context.stopping
        self._feedback = context.feedback
        self._running: _Running | None = None
        self._next: StateCommand | None = None
        self._ended_in: Status | None = None
        self._abandoned: list[_Running] = []
        self._procedures: dict[StateCommand, Callable[[], Steps]] = {
            StateCommand.ENABLE: device.enable,
            StateCommand.DISABLE: device.disable,
            StateCommand.PAUSE: device.pause,
            StateCommand.RESUME: device.resume,
            StateCommand.HOME: device.home,
            StateCommand.UNHOME: device.unhome,
        }

    @property
    def running(self) -> StateCommand | None:
        """The command that is being carried out; None once its end has been announced."""
        with self._board.lock:
            return None if self._running is None else self._running.command

    @property
    def outcome(self) -> Status:
        """The status in which the last command ended; the present one if there was none or it was cancelled.

        What the device says of itself replaces the status in the next cycle.
        """
        with self._board.lock:
            return self._ended_in or self._board.status

    @property
    def leads_to(self) -> OperatingState | None:
        """The state that the command leads to that is being carried out; None if there is none."""
        with self._board.lock:
            return None if self._running is None else self._running.target

    def accept(self, command: StateCommand, stamp_ns: int = 0) -> bool:
        """Begin a command with the next cycle, or announce the status at once if there is nothing to do.

        Args:
            command: that is asked for.
            stamp_ns: the sender's stamp, 0 if it gave none.

        Returns:
            Whether there is anything to do.

        Raises:
            CommandRefused: invalid in this state, without effect, or another one is running. `disable`
                replaces any, and `pause` all but enable and disable: a stop is never refused. `enable` waits
                for a `disable` in DISABLED.
        """
        with self._board.lock:
            self._ended_in = None
            if self._has_nothing_to_do(command):
                self._board.announce()
                return False
            running = self._running
            if running is not None:
                if running.target is self._board.status.state is OperatingState.DISABLED and (
                    command is StateCommand.ENABLE
                ):
                    self._next = command  # nothing is on its way that it could contradict
                    return True
                if not _ends(command, running.command):
                    raise CommandRefused(
                        "state_command",
                        Reason.TRANSITION_RUNNING,
                        f"{command}: {running.command} is running",
                        where=self._where,
                        remedy="Wait for it, or send disable.",
                    )
                if running.command is command:
                    self._next = None
                    return True
            target = target_of(self._board.status.state, command)
            if command is StateCommand.UNHOME and not self._needs_homing:
                raise self._without_effect(command)
            if running is not None:
                self._ended_where_it_began(running, f"{running.command}: broken off by {command}")
            self.cancel()
            self._running = _Running(command, target, stamp_ns)
            return True

    def _has_nothing_to_do(self, command: StateCommand) -> bool:
        """Whether what a command asks for is so already, or is being brought about."""
        running, status = self._running, self._board.status
        homing = running is not None and running.command in HOMING_COMMANDS
        if command is StateCommand.UNHOME:
            return running is None and not status.is_homed
        if command is StateCommand.HOME:
            ends_in = status.state if running is None else running.target
            return status.is_homed and ends_in in HOMING_STATES and not homing
        if running is not None and not (homing and command is StateCommand.ENABLE):
            return False
        reached = TRANSITIONS.get((status.state, command)) is status.state
        return reached and command in _DONE_WHERE_REACHED

    def _without_effect(self, command: StateCommand) -> CommandRefused:
        """Return what to say of a homing command that changes nothing."""
        if not self._needs_homing:
            what = "this device needs no homing: its positions always count"
            remedy = f"Leave {command} out: is_homed stays true."
        else:
            what = f"the device is {'' if command is StateCommand.UNHOME else 'not '}homed still"
            remedy = "Its diagnostics may say why."
        return CommandRefused(
            "state_command",
            Reason.NO_EFFECT,
            f"{command}: {what}",
            where=self._where,
            remedy=remedy,
        )

    def end_homing(self) -> None:
        """Cancel `home` if it runs: it moves, and `hold` was asked for. From any thread."""
        with self._board.lock:
            if self._running is not None and self._running.command is StateCommand.HOME:
                self.cancel()

    def break_off(self, by: str) -> None:
        """Cancel an `enable` or `resume` that may move, also one that waits. From any thread.

        Args:
            by: the stop.
        """
        with self._board.lock:
            running, following = self._running, self._next
            if following in self._moving:
                self._next = None
                self._board.warned(f"{following} was broken off by {by}")
            if running is None or running.command not in self._moving:
                return
            self.cancel()
            self._ended_in = replace(self._board.status, detail=f"broken off by {by}", remedy="")
            self._board.warned(f"{running.command} was broken off by {by}")
            self._ended_where_it_began(running, f"{running.command}: broken off by {by}")
            self._board.announce()

    def cancel(self) -> None:
        """Forget the running command. From any thread; `step` or `close_cancelled` ends its procedure."""
        with self._board.lock:
            self._next = None
            if self._running is not None:
                self._abandoned.append(self._running)
                self._running = None

    def close_cancelled(self) -> bool:
        """Let the procedures of commands that were cancelled clean up. I/O thread only.

        Returns:
            whether one of them may have set the hardware in motion: it is to be stopped.
        """
        may_move = False
        while self._abandoned:
            running = self._abandoned.pop()
            if running.procedure is not None:
                running.procedure.close()
                may_move |= self._came_to_nothing(running.command)
        return may_move

    def _came_to_nothing(self, command: StateCommand) -> bool:
        """Have the device leave what `enable` or `resume` had begun; return whether it may move for it."""
        if command in _ENABLING:
            self._stopping.left()
        return command in self._moving

    def step(self, now: float) -> None:
        """Resume the running procedure, if there is one.

        Raises:
            ConnectionLost: by the procedure.
        """
        if self.close_cancelled():
            self._stopping.stop()
        running = self._running
        if running is None:
            return
        has_begun = running.procedure is not None
        try:
            procedure = running.procedure or self._begin(running, now)
            if procedure is None:
                return
            has_ended = procedure.step()
        except ConnectionLost:
            raise
        except CommandRefused as refusal:
            self._refused(running, refusal, has_begun=has_begun)
            return
        except CrtkError as error:
            self._failed(running, f"{running.command}: {error.statement}", error.remedy)
            return
        except Exception as error:
            logger.exception("%s: %s", self._where, running.command)
            self._failed(running, f"{running.command}: {unexpected(error)}", REPORT)
            return
        if not has_begun and running.command is not StateCommand.DISABLE:
            self._stopping.moves_again()
        if not has_begun and running.command is StateCommand.HOME:
            self._feedback.follow_device()  # also where it is broken off, nothing goes back to before
        if running.command in self._moving or running.command in HOMING_COMMANDS:
            self._stopping.motion_sent()
        if has_ended and self._reached(running, now):
            self._stopping.motion_ended()
            return
        if procedure.is_overdue(now):
            procedure.close()
            self._failed(running, f"{running.command} did not finish in {self._timeout:g} s")

    def _begin(self, running: _Running, now: float) -> Procedure | None:
        """Begin the procedure, and return it; None while the hardware comes to rest before it."""
        if not running.stops:
            running.stops = True
            self._end_motion(str(running.command))
            if self._board.status.state is OperatingState.ENABLED:
                self._stopping.stop()
                return None
        if not self._stopping.confirmed and not self._stopping.overdue(now):
            return None
        if running.command in HOMING_COMMANDS:
            self._board.update(busy=True)
        steps = self._procedures[running.command]()
        running.procedure = Procedure(steps, self._where, now + self._timeout)
        return running.procedure

    def _ended(self, running: _Running) -> bool:
        """End a command; return False if it did not run any more."""
        if self._running is not running:
            return False
        self._running = None
        return True

    def _refused(
        self, running: _Running, refusal: CommandRefused, *, has_begun: bool = False
    ) -> None:
        told = refusal.of(running.stamp_ns, self._where, running.command)
        with self._board.lock:
            self._ended(running)
            self._board.update(busy=False)
            self._board.refused(told)
            self._board.announce()
        is_home = running.command is StateCommand.HOME
        if has_begun and (self._came_to_nothing(running.command) or is_home):
            self._stopping.stop()

    def _failed(self, running: _Running, reason: str, remedy: str = "") -> None:
        before = self._board.status.state
        was_enabled = before is OperatingState.ENABLED
        with self._board.lock:
            if self._ended(running):
                self._board.update(OperatingState.FAULT, reason, remedy=remedy, busy=False)
                self._ended_in = self._board.status
                if before is OperatingState.FAULT:
                    self._ended_where_it_began(running, reason, remedy)
        if self._came_to_nothing(running.command) or was_enabled:
            self._stopping.stop()

    def _ended_where_it_began(self, running: _Running, reason: str, remedy: str = "") -> None:
        """Tell the sender of a command that it has failed, though the state is the one in which it began.

        The state cannot show that: it is announced again for other reasons, too.
        """
        self._board.refused(
            CommandRefused(
                "state_command",
                Reason.FAILED,
                reason,
                where=self._where,
                remedy=remedy,
                stamp_ns=running.stamp_ns,
                state_command=running.command,
            )
        )

    def _reached(self, running: _Running, now: float) -> bool:
        """Announce the end, and return True; False if it is not known yet where the device is.

        In ENABLED the setpoint becomes the measured position, also after `home`, which moves and changes what
        positions mean.
        """
        homing = running.command in HOMING_COMMANDS
        if running.command is StateCommand.DISABLE and not self._stopping.confirmed:
            self._stopping.begin_anew()  # without power it may stand soon
        if running.ended is None:
            running.ended = now
        stays_put = running.command is StateCommand.UNHOME
        if (
            running.target is OperatingState.ENABLED
            and not stays_put
            and not self._feedback.seed(now, running.ended)
        ):
            return False
        homed = self._device.is_homed if self._needs_homing else True
        if homing and homed is (running.command is StateCommand.UNHOME):
            self._refused(running, self._without_effect(running.command))
            return True
        with self._board.lock:
            if self._ended(running):
                before = self._board.status
                carried_out = "" if running.command is StateCommand.DISABLE else None
                self._board.update(running.target, carried_out, homed=homed, busy=False)
                if self._board.status is before:
                    self._board.announce()
                self._ended_in = self._board.status
                following, self._next = self._next, None
                if following is not None:
                    self.accept(following)
        return True
