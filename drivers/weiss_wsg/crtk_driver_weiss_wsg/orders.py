"""The commands under way: one waits, one is sent and not answered, one is being carried out.

Answers name their command and nothing else. So the next one is sent when the one before has its first
answer, and of an answer that two may have had, a refusal is the newer one's, an end the older one's. An
end that comes late, of a motion that was replaced or was believed to have ended, would end the next:
where one may still come, an end counts for the running motion if what is told after it says that it
rests, and a move is where it was sent. Pure: no I/O.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import ClassVar, Final

from crtk_driver_weiss_wsg.tables import MOTIONS, REFUSALS, Command, Message, Status

__all__ = ["Order", "Orders"]

_OF_REPEATS: Final = frozenset({Status.RUNNING, Status.ABORTED})
PATIENCE: Final = 0.5
"""Seconds after which a command without an answer is sent again, and an end that was not told is believed."""
NEAR: Final = 1e-3
"""Metres by which the width may miss that of a move that has ended well."""


@dataclass(eq=False)
class Order:
    """A command; `status` is None until its end is known."""

    command: Command
    values: tuple[float, ...] = ()
    status: int | None = None
    sent: float = 0.0
    tries: int = 0

    def end(self, status: int) -> None:
        """It has ended, unless it has before."""
        self.status = status if self.status is None else self.status

    def is_done_at(self, width: float | None) -> bool:
        """Whether it can have ended well at a width (m); None: at any."""
        is_move = self.command is Command.MOVE
        return width is None or not is_move or abs(width - self.values[0]) < NEAR


class Orders:
    """Those of one connection. A command that is refused since another is running is sent again after a stop.

    Attributes:
        waiting, asked, running: the three.
        unseen: what must be told anew before it counts as told of the command that was answered last.
    """

    TRIES: ClassVar[int] = 3
    """How often a command is sent at most."""

    def __init__(self) -> None:
        self.waiting: Order | None = None
        self.asked: Order | None = None
        self.running: Order | None = None
        self.unseen: set[Command] = set()
        self._refused: Order | None = None  # for the sake of another, which is being stopped
        self._last: Order | None = None
        self._owed: Counter[Command] = Counter()  # ends that were not told
        self._doubtful: int | None = None  # of the running one, or of one before
        self._rests = True
        self._still: float | None = None

    @property
    def settled(self) -> bool:
        """Whether what it tells is told after all commands."""
        return not (self.waiting or self.asked or self._refused or self.unseen)

    def put(self, order: Order) -> None:
        """Let an order wait, in the place of one that waits."""
        self._leave_out()
        self.waiting = order

    def _leave_out(self) -> None:
        """What was not sent is not sent any more."""
        for other in (self.waiting, self._refused):
            if other is not None:
                other.end(Status.ABORTED)
        self.waiting = self._refused = None

    def stop(self) -> None:
        """Leave out what was not sent, and stop what was."""
        if self.asked is not None and self.asked.command is Command.STOP:
            self._leave_out()  # what came after that stop, or has waited for it, does not follow this one
            return
        if self.asked is not None:
            self.asked.end(Status.ABORTED)
        self.asked = None
        self.put(Order(Command.STOP))

    def due(self, now: float) -> Order | None:
        """Return what is to be sent now, if anything is."""
        order = self.asked
        if order is not None:
            if now - order.sent <= PATIENCE:
                return None
        else:
            order = self.waiting
            if order is None or (order.command is not Command.STOP and not self._lets(order)):
                return None
            self.waiting = None
        self.asked = self._last = order
        order.sent, order.tries = now, order.tries + 1
        return order

    def _lets(self, order: Order) -> bool:
        """Whether what is being carried out may be replaced: a move; not by what was refused for it."""
        is_move = self.running is None or self.running.command is Command.MOVE
        return is_move and (self._rests or not order.tries)

    def see(self, rests: bool, now: float, width: float | None = None) -> None:
        """Take from its reports whether it rests: it may do so without ever having told the end.

        Args:
            rests: it says that it goes nowhere.
            now: monotonic seconds.
            width: in m, at which a move must have ended; None: at any.
        """
        self._rests = rests
        if self._doubtful is not None and not self.unseen:
            self._resolve(rests, width)
        if self.running is None or self.unseen or not rests:
            self._still = None
        elif self._still is None:
            self._still = now
        elif now - self._still > PATIENCE:
            self._owed[self.running.command] += 1
            self.running.end(Status.OK if self.running.is_done_at(width) else Status.FAILED)
            self.running = None

    def _resolve(self, rests: bool, width: float | None) -> None:
        """Judge an end by what was told after it: it is the running motion's if nothing moves any more."""
        status, running, self._doubtful = self._doubtful, self.running, None
        assert status is not None
        if running is None:
            return
        if rests and (status != Status.OK or running.is_done_at(width)):
            running.end(status)
            self.running = None
            self._owed.clear()
        else:
            self._owed[running.command] -= 1

    def heed(self, message: Message) -> None:
        """Take an answer."""
        command, status = message.about, message.status
        asked = self.asked if self.asked and self.asked.command is command else None
        running = self.running if self.running and self.running.command is command else None
        if status == Status.PENDING:
            last = self._last
            if asked is None and last and last.command is command and last.status == Status.OK:
                asked, last.status = last, None  # the end of another was taken for its own
            if asked is not None:
                self._begin(asked)
        elif asked is not None and (running is None or status in REFUSALS):
            self.asked = None
            if status == Status.RUNNING and asked.tries < self.TRIES and not self.waiting:
                self.waiting, self._refused = Order(Command.STOP), asked
                return
            asked.end(status)
            self._tell_anew(command)
            if command is Command.STOP and not self.waiting:
                self.waiting, self._refused = self._refused, None
        elif running is not None and running.tries > 1 and status in _OF_REPEATS:
            running.tries -= 1  # it was sent again, and is its own obstacle
        elif running is not None and self._owed[command] > 0:
            self._doubtful = status
            self._tell_anew(command)
            self.unseen.add(Command.WIDTH)
        elif running is not None:
            running.end(status)
            self.running = None

    def _begin(self, order: Order) -> None:
        if self.running is not None and self.running is not order:
            self._owed[self.running.command] += 1
            self.running.end(Status.ABORTED)
        self._doubtful = None
        self.asked, self.running, self._still = None, order, None
        self._tell_anew(order.command)

    def _tell_anew(self, command: Command) -> None:
        if command in MOTIONS or command in (Command.STOP, Command.ACKNOWLEDGE):
            self.unseen = {Command.SYSTEM, Command.GRASPING}
