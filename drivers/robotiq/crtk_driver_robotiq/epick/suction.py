"""What a vacuum gripper is doing, from its status over time: it evacuates, holds, has lost, lets go."""

from __future__ import annotations

from typing import Final

from crtk_driver_robotiq.epick.registers import SURROUNDING, Command, Detected, Status, Valve
from crtk_drivers.kit.gripping import HELD, Doing, Echo

__all__ = ["Suction"]

LAG: Final = 0.15
"""Seconds after the echo of a request in which gOBJ may still be that of the one before."""


class Suction:
    """Follows one gripper; no I/O and no clock.

    Attributes:
        doing: now.
        echo: whose commands it echoes.
        offered: a command that may have come, though nothing has acknowledged it yet.
    """

    def __init__(self) -> None:
        self.echo: Echo[Command] = Echo(lambda command: (command.pressure, command.go))
        self.begin()

    def begin(self) -> None:
        """A connection begins: what it was sent before is of the past."""
        self.doing = Doing.UNKNOWN
        self.echo.begin()
        self._since = 0.0
        self._has_regulated = True
        self.offered: Command | None = None

    def delivered(self, command: Command, now: float) -> None:
        """A command was acknowledged."""
        self.echo.sent(command, now)
        self._since, self._has_regulated = now, False
        if command.go:
            lets_go = command.pressure >= SURROUNDING
            self.doing = Doing.RELEASING if lets_go else Doing.EVACUATING

    def see(self, status: Status, now: float) -> None:
        """Take a status that was asked for at `now`: it may be read late."""
        self.doing = self._told(status, now)

    def _told(self, status: Status, now: float) -> Doing:
        if not status.ready:
            return Doing.INACTIVE
        if not self.echo.see((status.requested, status.goes), self.offered, now):
            return self.doing
        if not status.goes or status.requested >= SURROUNDING:
            lets_go = status.valve in (Valve.PASSIVE_RELEASE, Valve.ACTIVE_RELEASE)
            return Doing.RELEASING if lets_go else Doing.FREE
        if status.detected is Detected.UNKNOWN:
            self._has_regulated = True
            return Doing.EVACUATING
        if not self._has_regulated and now - self._since < LAG:
            return Doing.EVACUATING
        self._has_regulated = True
        if status.detected is Detected.NONE:
            had = self.doing in {*HELD, Doing.LOST}
            return Doing.LOST if had else Doing.NOTHING
        return Doing.HOLDS_WEAKLY if status.detected is Detected.AT_MINIMUM else Doing.HOLDS
