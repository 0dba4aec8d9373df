"""What a gripper is doing, from its status over time."""

from __future__ import annotations

import math
from typing import Final

from crtk_driver_robotiq.registers import Activation, Command, Contact, Status
from crtk_drivers.kit.gripping import HELD, Doing, Echo

__all__ = ["Grip"]

LAG: Final = 0.15
"""Seconds after the echo of a request in which gOBJ may still be that of the one before."""

_AT: Final = {
    Contact.AT_REQUEST: Doing.THERE,
    Contact.WHILE_CLOSING: Doing.HOLDS,
    Contact.WHILE_OPENING: Doing.HOLDS_INSIDE,
}


class Grip:
    """Follows one gripper; no I/O and no clock.

    Attributes:
        doing: now.
        moves: the fingers do; also where what is told is that they have lost something.
        echo: whose commands it echoes.
        offered: a command that may have come, though nothing has acknowledged it yet.
    """

    def __init__(self) -> None:
        self.echo: Echo[Command] = Echo(lambda command: (command.position, command.go))
        self.begin()

    def begin(self) -> None:
        """A connection begins: what it was sent before is of the past."""
        self.doing = Doing.UNKNOWN
        self.moves = True
        self.echo.begin()
        self._since = -math.inf
        self._has_moved = True
        self._is_halted = False
        self._requested: int | None = None
        self.offered: Command | None = None

    def delivered(self, command: Command, now: float, *, halts: bool = False) -> None:
        """A command was acknowledged; `halts`: its position is where the fingers were."""
        self.doing = Doing.MOVING if command.go else self.doing
        self.moves = command.go or self.moves
        self.echo.sent(command, now)
        self._since, self._has_moved, self._is_halted = now, False, halts

    def see(self, status: Status, now: float) -> None:
        """Take a status that was asked for at `now`: it may be read late."""
        same = self._requested in (status.requested, None)
        self._requested = status.requested
        if not same and self.echo.command is None:  # somebody else has sent it elsewhere
            self._since, self._has_moved, self._is_halted = now, False, False
        before, self.doing = self.doing, self._told(status, now)
        self.moves = self.doing is Doing.MOVING
        let_go = before in {*HELD, Doing.LOST} and self.doing in (Doing.MOVING, Doing.THERE)
        if let_go and same:
            self.doing = Doing.LOST
        elif self.doing is Doing.THERE and self._is_halted:
            self.doing = Doing.STOPPED

    def _told(self, status: Status, now: float) -> Doing:
        if status.activation is not Activation.DONE:
            return Doing.INACTIVE
        if not self.echo.see((status.requested, status.goes), self.offered, now):
            return Doing.MOVING
        if not status.goes:
            return Doing.STOPPED
        if status.contact is Contact.MOVING:
            self._has_moved = True
            return Doing.MOVING
        # What is told as moving may be the end of the motion before, and what follows that as well.
        is_believed = self._has_moved and status.ends_as_requested
        if not is_believed and now - self._since < LAG:
            return Doing.MOVING
        self._has_moved = True
        return _AT[status.contact]
