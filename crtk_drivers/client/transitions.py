"""When a state command has been carried out, told from what arrives on ``operating_state``."""

from __future__ import annotations

import time

from crtk_drivers.client.status import Watch
from crtk_drivers.errors import CommandRefused, TransitionFailed
from crtk_drivers.state import OperatingState, StateCommand, Status, target_of

QUIET_TIME = 0.5
"""Seconds after which homing that never showed as busy had nothing to do."""
ANSWER_TIME = 0.1
"""Seconds in which the answer to a command that changes nothing arrives."""
_HOMING = (StateCommand.HOME, StateCommand.UNHOME)
_REMEDY = {
    OperatingState.FAULT: "Remove the cause, which is on /diagnostics, then send enable.",
}


class Transition:
    """One state command that was sent.

    Args:
        command: what was sent.
        before: the status at that time.
        target: the state that it leads to.
        needs_homing: is_homed follows `home` and `unhome`.
    """

    def __init__(
        self, command: StateCommand, before: Status, target: OperatingState, needs_homing: bool
    ) -> None:
        self._command = command
        self._latest = before
        self._before = before
        self._target = target
        self._was_busy = False
        self._sent = time.monotonic()
        self._homed = (
            command is StateCommand.HOME if needs_homing and command in _HOMING else before.is_homed
        )

    def wait(self, watch: Watch, deadline: float, where: str) -> None:
        """Wait until it is carried out.

        Raises:
            CommandRefused: the device refuses it.
            TransitionFailed: it ended in another state, or did not end before `deadline`.
        """
        while True:
            event = watch.next(max(0.0, deadline - time.monotonic()))
            if isinstance(event, CommandRefused):
                if event.command == "state_command":
                    raise event
                continue
            if event is not None:
                self._latest = event
                if self._reached(event):
                    if self._command is StateCommand.UNHOME and not self._visible:
                        self._let_pass(watch)
                    return
            if event is None or self._failed(event):
                how = "ended in" if event is not None else "did not end in time: the device is"
                state = self._latest.state
                remedy = _REMEDY.get(state, "The reason is on /diagnostics.")
                raise TransitionFailed(f"{self._command} {how} {state}", where=where, remedy=remedy)

    @property
    def _visible(self) -> bool:
        return self._homed is not self._before.is_homed

    @staticmethod
    def _let_pass(watch: Watch) -> None:
        """Nothing changes, so that a heartbeat looks like the answer: wait for one more status."""
        event = watch.next(ANSWER_TIME)
        if isinstance(event, CommandRefused) and event.command == "state_command":
            raise event

    def _reached(self, status: Status) -> bool:
        if self._command is StateCommand.HOME:
            self._was_busy = self._was_busy or status.is_busy
            # A heartbeat from before homing began says the same as its end.
            begun = self._was_busy or time.monotonic() - self._sent > QUIET_TIME
            if status.is_busy or not begun:
                return False
        homed = self._command not in _HOMING or status.is_homed is self._homed
        return homed and status.state is self._target

    def _failed(self, status: Status) -> bool:
        if self._command is StateCommand.HOME and self._was_busy and not status.is_busy:
            return True
        if status.state in (self._target, self._before.state):
            return False
        if status.state is OperatingState.FAULT:
            return True
        try:  # or is it news of before, when the command came?
            return target_of(status.state, self._command) is not self._target
        except CommandRefused:
            return True
