"""What fingers are doing, and what to send next: a command while they are busy is ignored by the hardware.

So a command goes out when they rest, and counts as taken when they are seen to be busy, or are where it
sends them. A motion that is to be replaced is stopped first. No I/O and no clock.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from crtk_driver_onrobot.registers import Command
from crtk_drivers.kit.gripping import Doing

__all__ = ["Grip"]

LAG: Final = 0.1
"""Seconds after a command in which they may not be busy yet."""
EDGE: Final = 0.4
"""Seconds after which a command that shows no effect is sent again."""
TRIES: Final = 3
"""How often it is sent."""
NEAR: Final = 0.0006
"""By how much m the opening may miss the command."""
STUCK: Final = 2.0
"""Seconds in which a stop must end a motion."""
AWAY: Final = 0.003
"""By how much m fingers that have lost something may go the other way before it is somebody else's doing."""


class Grip:
    """Follows one pair of fingers.

    Args:
        stopping: makes the command that stops them.
        inside: they grip by opening.

    Attributes:
        doing: now.
        taken_over: another program moves them.
        refused: why the last command was not carried out; empty: it was, or may be.
        ignored: how many commands showed no effect.
    """

    def __init__(self, stopping: Callable[[], Command], *, inside: bool) -> None:
        self._stopping = stopping
        self._outwards = 1.0 if inside else -1.0  # the way in which they grip
        self.ignored = 0
        self.begin()

    def begin(self) -> None:
        """A connection begins: what was sent before is of the past."""
        self.doing = Doing.UNKNOWN
        self.taken_over = False
        self.refused = ""
        self._wanted: Command | None = None
        self._halt: Command | None = None
        self._halting_since: float | None = None
        self._sent: Command | None = None
        self._since = 0.0
        self._tries = 0
        self._taken = True
        self._lets_go = self._busy = self._unsure = False
        self._at = self._from = self._held_at = 0.0

    # ------------------------------------------------------------------------------ what is asked for

    def go(self, command: Command, now: float, *, at_once: bool) -> None:
        """Send this, and forget what was to be sent; `at_once`: a motion is stopped for it."""
        if at_once:
            self.stop(now)
        self._wanted, self._tries, self.refused = command, 0, ""

    def stop(self, now: float) -> Command | None:
        """Stop a motion; what is gripped is kept. Return what stops it; None: there is none."""
        self._wanted = None
        if (self._underway or self._unsure) and self._halting_since is None:
            self._halt, self._halting_since = self._stopping(), now
        return self._halt

    def adopt(self) -> None:
        """What they do now is as if we had sent it."""
        self.taken_over, self.refused = False, ""

    @property
    def _underway(self) -> bool:
        return self._busy or not self._taken

    @property
    def rests(self) -> bool:
        """Whether they go nowhere, and nothing is left to be sent."""
        return not (self._underway or self._wanted or self._halt)

    @property
    def is_told(self) -> bool:
        """Whether all that was to be sent has been taken."""
        return self._taken and not (self._wanted or self._halt)

    @property
    def next(self) -> Command | None:
        """What is to be sent now."""
        return self._halt or (None if self._underway else self._wanted)

    # ---------------------------------------------------------------------------------- what is seen

    def tried(self, command: Command) -> None:
        """A command was not acknowledged in time: it may have come, or may still come."""
        self._unsure |= command.opening is not None

    def delivered(self, command: Command, now: float) -> None:
        """A command was acknowledged."""
        self._since, self._unsure = now, False
        if command is self._wanted:
            self._wanted = None
        if command is self._halt:
            self._halt = None
        if command.opening is None:
            self._sent = None
            return
        leads = self._outwards * (command.opening - self._held_at)
        self._lets_go = self.doing is Doing.HOLDS and leads < -NEAR
        self._sent, self._taken, self.taken_over = command, False, False
        self._tries += 1
        self._from = self._at
        self.doing = Doing.MOVING

    def see(self, opening: float, now: float, *, busy: bool, grips: bool) -> None:
        """Take a status: the opening in m, whether they move, and whether something is gripped."""
        began, self._busy, self._at = busy and not self._busy, busy, opening
        if not self._taken:
            self._taken = busy or (now - self._since > LAG and self._has_shown(opening, grips))
            if not self._taken and now - self._since > EDGE:
                self._again()
        elif not busy and not grips and self._went_elsewhere:
            self._again()
        elif began and self._is_strange and self.doing in (Doing.THERE, Doing.STOPPED):
            self.taken_over = True
        self._look_after_stop(now)
        self.doing = self._told(opening, grips)
        if not self._underway:
            self._sent = None

    @property
    def _is_strange(self) -> bool:
        """Whether a motion that is seen now is not ours."""
        return self._sent is None and not self._unsure

    def _has_shown(self, opening: float, grips: bool) -> bool:
        """Whether they rest as the command wants them: it may have been too short to be seen."""
        if self._sent is None or self._sent.opening is None:
            return True
        return abs(opening - self._sent.opening) < NEAR or (grips and not self._lets_go)

    @property
    def _went_elsewhere(self) -> bool:
        """Whether the motion that was seen led the other way: it had begun before the command came."""
        if self._sent is None or self._sent.opening is None:
            return False
        moved = self._at - self._from
        return abs(moved) > NEAR and moved * (self._sent.opening - self._from) < 0.0

    def _again(self) -> None:
        """A command showed no effect: send it again, unless there is another one, or a stop."""
        if self._halting_since is not None:
            return
        self.ignored += 1
        self._taken = True
        if self._wanted is None and self._tries < TRIES:
            self._wanted = self._sent
        elif self._wanted is None:
            self.refused = f"it takes no command, sent {TRIES} times"
        self._sent = None

    def _look_after_stop(self, now: float) -> None:
        if self._halting_since is None:
            return
        if not (self._underway or self._unsure):
            self._halt = self._halting_since = None
        elif now - self._halting_since > STUCK and not self.refused:
            self._wanted, self.refused = None, "it stays busy, though it was told to stop"
        elif self._halt is None and now - self._since > LAG:
            self._halt = self._stopping()

    def _told(self, opening: float, grips: bool) -> Doing:
        was, sent = self.doing, self._sent
        if grips and (sent is None or not self._underway):
            self._held_at = opening
            return Doing.HOLDS
        if self._is_strange and was in (Doing.HOLDS, Doing.LOST):
            if self._busy and self._outwards * (opening - self._held_at) < -AWAY:
                self.taken_over = True  # somebody has let go of it
                return Doing.MOVING
            return Doing.LOST
        if self._underway:
            return Doing.MOVING
        if sent is None or sent.opening is None:
            return was if was is Doing.THERE else Doing.STOPPED
        return Doing.THERE if abs(opening - sent.opening) < NEAR else Doing.STOPPED
