"""What a gripper is doing, from its status over time: on its way, there, what it holds, what it lost."""

from __future__ import annotations

from typing import Final

from crtk_driver_schunk.gripper.image import Command, Control, State, Status
from crtk_drivers.kit.gripping import Doing

__all__ = ["Grip"]

LAG: Final = 0.15
"""Seconds after a command was taken in which the status may still be that of the one before."""
STILL: Final = 0.2
"""Seconds without motion after which a gripper that reports no end of it rests."""
NEAR: Final = 5e-4
"""Metres by which fingers may miss the goal of a move that they tell to have reached."""
STEP: Final = 20e-6
"""Metres that count as motion."""


_BY_BIT: Final = (
    (State.ERROR, Doing.ERROR),
    (State.LOST, Doing.LOST),
    (State.NOT_FEASIBLE, Doing.REFUSED),
    (State.WRONG_PART, Doing.WRONG),
    (State.GRIPPED, Doing.HOLDS),
    (State.NO_PART, Doing.NOTHING),
    (State.POSITION | State.SUCCESS, Doing.THERE),
    (State.PRE_GRIP, Doing.PRESSING),
)
"""The first whose bits are all set."""
_MOVES: Final = Control.MOVE | Control.GRIP | Control.RELEASE | Control.BRAKE_TEST


class Grip:
    """Follows one gripper; no I/O and no clock.

    Attributes:
        doing: now.
        runs_on: the fingers move, though what they held is lost.
    """

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """A connection begins: what it was told before is of the past."""
        self.doing = Doing.UNKNOWN
        self.runs_on = False
        self._taken: Command | None = None
        self._since = self._moved = 0.0
        self._has_begun = True
        self._position: float | None = None
        self._has_moved = False

    def taken(self, command: Command, now: float) -> None:
        """The gripper has taken a command."""
        self._taken, self._since = command, now
        self._has_begun = not command.bits & _MOVES  # such a command may end as it begins
        if not self._has_begun:
            self._moved = now

    def see(self, status: Status, now: float, *, stops: bool = False) -> None:
        """Take a status that was read; `stops`: a stop is on its way, and perhaps there already."""
        if self._position is None:
            self._position, self._moved = status.position, now
        elif abs(status.position - self._position) > STEP:
            self._position, self._moved, self._has_moved = status.position, now, True
        found = next((doing for bits, doing in _BY_BIT if bits in status.bits), None)
        if found in (None, Doing.PRESSING):
            self._has_begun = True
        is_strange = not self._has_begun or (found is Doing.THERE and self._is_off(status.position))
        if found not in (None, Doing.ERROR) and is_strange and now - self._since < LAG:
            found = None  # of the command before
        if found is None:
            found = Doing.MOVING if self._has_moved or self._taken else Doing.UNKNOWN
            found = Doing.STOPPED if now - self._moved > STILL else found
        self.runs_on = found is Doing.LOST and self._has_moved and now - self._moved <= STILL
        was_stopped = stops or (self._taken is not None and Control.STOP in self._taken.bits)
        self.doing = Doing.STOPPED if was_stopped and found is Doing.THERE else found

    def _is_off(self, position: float) -> bool:
        """Whether a position is not where the last command leads."""
        taken = self._taken
        if taken is None or Control.MOVE not in taken.bits:
            return False
        return abs(position - taken.position) > NEAR
