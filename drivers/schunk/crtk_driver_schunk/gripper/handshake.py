"""How a command is handed over: an idle image, then the command; it is taken when the toggle bit has changed.

No I/O and no clock. Two images in a row that are equal are one command for the gripper, therefore the idle
one. What is lost on the way is found by the toggle, and sent again.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final

from crtk_driver_schunk.gripper.image import IDLE, Command, Control, State, Status

__all__ = ["GIVEN_UP", "Handshake"]

ANSWERED: Final = 0.25
"""Seconds in which a command must be taken (the manual's are 0.1), or it is handed over anew."""
GIVEN_UP: Final = 4
"""Attempts after which a gripper counts as one that takes no commands."""


class _Step(Enum):
    REST = auto()
    CLEAR = auto()
    """The idle image is to be written."""
    BEFORE = auto()
    """The toggle is to be read."""
    SEND = auto()
    """The command is to be written."""
    TAKEN = auto()
    """The toggle is waited for."""


class Handshake:
    """Hands over one command at a time. `ask` is for any thread, all else for the I/O thread.

    Attributes:
        attempts: so often the present command was handed over and not taken.
        repeated: all of these so far.
        by_others: commands that were taken, and not ours.
        has_shouted: a stop was written past this, which will be taken as well; set by any thread.
    """

    def __init__(self) -> None:
        self.repeated = self.by_others = 0
        self.begin()

    def begin(self) -> None:
        """A connection begins: nothing is under way."""
        self.attempts = 0
        self.has_shouted = False
        self._next: Command | None = None
        self._command: Command | None = None
        self._step = _Step.REST
        self._is_tried = self._is_withdrawn = False
        self._has_replaced = False  # a command that may have been taken: its toggle is ours too
        self._toggle: bool | None = None
        self._since = 0.0

    def ask(self, command: Command) -> None:
        """Hand over a command after the present one, in place of what has waited; a stop instead of both."""
        self._next = command

    def withdraw(self) -> bool:
        """Drop what has not been written; return whether nothing of it has been.

        What was written, or may have been (its acknowledgement is late, or lost), is not handed over again.
        """
        self._next = None
        if self._is_tried:
            self._step, self._is_withdrawn = _Step.TAKEN, True
        else:
            self._command, self._step = None, _Step.REST
        return self._command is None

    @property
    def pending(self) -> Command | None:
        """What was asked for last and has not been taken yet."""
        return self._next or self._command

    @property
    def is_midway(self) -> bool:
        """Whether a write follows at once, before the status means anything to others."""
        return self._step in (_Step.CLEAR, _Step.SEND)

    def to_write(self) -> Command | None:
        """Return what is to be written now; None: the status is to be read."""
        waiting = self._next
        if waiting is not None and (self._step is _Step.REST or _stops(waiting)):
            self._command, self._next = waiting, None
            self._step, self.attempts = _Step.CLEAR, 0
            self._has_replaced |= self._is_tried
            self._is_tried = self._is_withdrawn = False
        if self._step is _Step.CLEAR:
            return IDLE
        if self._step is not _Step.SEND:
            return None
        self._is_tried = True
        return self._command

    def written(self, now: float) -> None:
        """What was to be written has been."""
        self._step = _Step.BEFORE if self._step is _Step.CLEAR else _Step.TAKEN
        self._since = now

    def seen(self, status: Status, now: float) -> Command | None:
        """Take a status that was read; return the command that it shows to be taken."""
        before, self._toggle = self._toggle, State.TOGGLE in status.bits
        changed = before is not None and before is not self._toggle
        is_replaced = False
        if self._step is _Step.BEFORE:
            self._step = _Step.SEND
            is_replaced, self._has_replaced = self._has_replaced, False
        elif self._step is _Step.TAKEN:
            return self._answered(changed, now)
        if changed and self.has_shouted and not is_replaced:
            self.has_shouted = False
        else:
            self.by_others += changed and not is_replaced
        return None

    def _answered(self, is_taken: bool, now: float) -> Command | None:
        if is_taken:
            taken, self._command = self._command, None
            self.has_shouted = self.has_shouted and not (taken and _stops(taken))
            self._step, self.attempts, self._is_tried = _Step.REST, 0, False
            return taken
        if now - self._since > ANSWERED and self._is_withdrawn:
            self._command, self._step, self._is_tried = None, _Step.REST, False
        elif now - self._since > ANSWERED:
            self._step = _Step.CLEAR
            self.attempts += 1
            self.repeated += 1
        return None


def _stops(command: Command) -> bool:
    return Control.STOP in command.bits or Control.RUN not in command.bits
