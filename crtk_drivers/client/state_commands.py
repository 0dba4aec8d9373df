"""When a state command has been carried out, told from what arrives on ``operating_state``."""

from __future__ import annotations

import time
from typing import Final

from crtk_drivers.client.announcements import Watch
from crtk_drivers.errors import CommandRefused, Reason, TransitionFailed
from crtk_drivers.front.base import DeviceFront
from crtk_drivers.state import OperatingState, StateCommand, Status, target_of

LOOK_PERIOD: Final = 1.0
"""Seconds between two looks whether a device that is busy is there still."""

_HOMING = (StateCommand.HOME, StateCommand.UNHOME)
_REMEDY = {
    OperatingState.FAULT: "Remove the cause, which is on /diagnostics, then send enable.",
}


def home_to_its_end(device: DeviceFront) -> None:
    """Home a device, and wait for that as long as it is busy: it moves, and somebody is to look after it.

    Raises:
        CrtkError: as of `DeviceFront.state_command`.
    """
    try:
        device.home()
    except TransitionFailed:
        if not device.is_busy():
            raise
        while device.is_busy():
            device.wait_for_busy(False, LOOK_PERIOD)
        if not device.is_homed():
            raise


class Transition:
    """One state command that was sent.

    Args:
        command: what was sent.
        before: the status at that time.
        target: the state that it leads to.
    """

    def __init__(self, command: StateCommand, before: Status, target: OperatingState) -> None:
        self._command = command
        self._latest: Status | None = None
        self._before = before
        self._target = target
        self._was_busy = False
        self._homed = command is StateCommand.HOME
        self._changes_home = command in _HOMING and before.is_homed is not self._homed

    def wait(self, watch: Watch, deadline: float, where: str, stamp_ns: int) -> None:
        """Wait until what was sent with a stamp is carried out.

        Raises:
            CommandRefused: the device refuses it.
            TransitionFailed: it ended in another state, or did not end before `deadline`.
        """
        while True:
            event = watch.next(max(0.0, deadline - time.monotonic()))
            if isinstance(event, CommandRefused):
                if event.command == "state_command" and event.stamp_ns == stamp_ns:
                    if event.reason is Reason.FAILED:
                        raise TransitionFailed(event.detail, where=where, remedy=event.remedy)
                    raise event
                continue
            if event is not None:
                self._latest = event
            if self._latest is not None and self._reached(self._latest):
                return
            ended = event is not None and self._failed(event)
            if ended or event is None:
                how = "ended in" if ended else "did not end in time: the device is"
                state = (self._latest or self._before).state
                remedy = _REMEDY.get(state, "The reason is on /diagnostics.")
                raise TransitionFailed(f"{self._command} {how} {state}", where=where, remedy=remedy)

    def _reached(self, status: Status) -> bool:
        if self._changes_home:
            self._was_busy = self._was_busy or status.is_busy
            if status.is_busy or status.is_homed is not self._homed:
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
