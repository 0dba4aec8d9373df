"""What a gripper is doing, from its status over time: on its way, there, at an object, and what it holds."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from crtk_driver_robotiq.registers import Activation, Command, Contact, Status

__all__ = ["Doing", "Grip"]

LAG: Final = 0.15
"""Seconds after the echo of a request in which gOBJ may still be that of the one before."""
OTHERS: Final = 0.25
"""Seconds after which an echo that is not of our request is another master's."""


class Doing(StrEnum):
    """What it does."""

    UNKNOWN = "unknown"
    INACTIVE = "not activated"
    STOPPED = "stopped"
    MOVING = "moving"
    THERE = "at the position"
    CLOSED_ONTO = "closed on an object"
    OPENED_ONTO = "opened onto an object"
    LOST = "object lost"


_AT: Final = {
    Contact.AT_REQUEST: Doing.THERE,
    Contact.WHILE_CLOSING: Doing.CLOSED_ONTO,
    Contact.WHILE_OPENING: Doing.OPENED_ONTO,
}
_HELD: Final = frozenset({Doing.CLOSED_ONTO, Doing.OPENED_ONTO})
RESTS: Final = frozenset({*_HELD, Doing.THERE, Doing.STOPPED, Doing.LOST})


class Grip:
    """Follows one gripper; no I/O and no clock.

    Attributes:
        doing: now.
        may_hold: whether it held something when that could be told last: power may have been away since.
        taken_over: by another master, which sent it elsewhere.
    """

    def __init__(self) -> None:
        self.may_hold = False
        self.begin()

    def begin(self) -> None:
        """A connection begins: what it was sent before is of the past."""
        self.doing = Doing.UNKNOWN
        self.taken_over = False
        self._sent: Command | None = None
        self._since = 0.0
        self._has_moved = True
        self._requested: int | None = None
        self._strange_since: float | None = None

    def adopt(self) -> None:
        """What it does now is as if we had sent it."""
        self._sent, self.taken_over, self._strange_since = None, False, None

    def delivered(self, command: Command, now: float) -> None:
        """A command was acknowledged."""
        self.doing = Doing.MOVING if command.go else self.doing
        self._sent, self._since, self._has_moved = command, now, False
        self.taken_over, self._strange_since = False, None

    def see(self, status: Status, now: float) -> None:
        """Take a status that was read."""
        same = self._requested in (status.requested, None)
        self._requested = status.requested
        if not same and self._sent is None:  # somebody else has sent it elsewhere
            self._since, self._has_moved = now, False
        before, self.doing = self.doing, self._told(status, now)
        let_go = before in {*_HELD, Doing.LOST} and self.doing in (Doing.MOVING, Doing.THERE)
        if let_go and same:
            self.doing = Doing.LOST
        if self.doing in _HELD:
            self.may_hold = True
        elif self.doing in (Doing.THERE, Doing.LOST):
            self.may_hold = False

    @property
    def holds(self) -> bool:
        """Whether it holds something."""
        return self.doing in _HELD

    @property
    def rests(self) -> bool:
        """Whether it goes nowhere by itself."""
        return self.doing in RESTS or self.doing is Doing.INACTIVE

    def _told(self, status: Status, now: float) -> Doing:
        if status.activation is not Activation.DONE:
            return Doing.INACTIVE
        if self._sent is not None and not self._is_ours(status, self._sent, now):
            return Doing.MOVING
        if not status.goes:
            return Doing.STOPPED
        if status.contact is Contact.MOVING:
            self._has_moved = True
            return Doing.MOVING
        if not self._has_moved and now - self._since < LAG:
            return Doing.MOVING
        self._has_moved = True
        return _AT[status.contact]

    def _is_ours(self, status: Status, sent: Command, now: float) -> bool:
        """Whether the echo is that of what we have sent."""
        if (status.requested, status.goes) == (sent.position, sent.go):
            self._strange_since = None
            return True
        if self._strange_since is None:
            self._strange_since = now
        self.taken_over = now - self._strange_since > OTHERS
        return False
