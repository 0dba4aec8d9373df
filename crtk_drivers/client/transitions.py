"""When a state command has been carried out, told from what arrives on ``operating_state``."""

from __future__ import annotations

import time

from crtk_drivers.client.status import Watch
from crtk_drivers.errors import CommandRefused, TransitionFailed
from crtk_drivers.state import OperatingState, StateCommand, Status, target_of

QUIET_TIME = 0.5
"""Seconds after which homing or unhoming that never showed as busy had nothing to do."""
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
        self._latest: Status | None = None
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
        quiet = self._sent + QUIET_TIME
        while True:
            now = time.monotonic()
            end = quiet if now < quiet < deadline else deadline
            event = watch.next(max(0.0, end - now))
            if isinstance(event, CommandRefused):
                if event.command == "state_command":
                    raise event
                continue
            if event is not None:
                self._latest = event
            if self._latest is not None and self._reached(self._latest):
                return
            ended = event is not None and self._failed(event)
            if ended or (event is None and end == deadline):
                how = "ended in" if ended else "did not end in time: the device is"
                state = (self._latest or self._before).state
                remedy = _REMEDY.get(state, "The reason is on /diagnostics.")
                raise TransitionFailed(f"{self._command} {how} {state}", where=where, remedy=remedy)

    def _reached(self, status: Status) -> bool:
        if self._command in _HOMING:
            self._was_busy = self._was_busy or status.is_busy
            # A heartbeat from before it began says the same as its end, unless is_homed changes.
            begun = (
                self._was_busy
                or status.is_homed is not self._before.is_homed
                or time.monotonic() - self._sent > QUIET_TIME
            )
            if status.is_busy or not begun or status.is_homed is not self._homed:
                return False
        return status.state is self._target

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
