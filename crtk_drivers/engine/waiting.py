"""A move that waits for a state command that leads to ENABLED: ``home`` and then ``move_jp``, at once.

There is room for one. It begins when the state command has been carried out, within the time that the
device declares for that (`Capabilities.transition_timeout`), and is judged then, from where the device is.
Any stop ends it, a fault, the next motion command and the next state command, so that nothing begins late,
and nothing twice. While it waits, the device is busy.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass

from crtk_drivers.commands import Command
from crtk_drivers.engine.transitions import Transitions
from crtk_drivers.errors import REPORT, CommandRefused, Reason
from crtk_drivers.motion.arbiter import Client, Order
from crtk_drivers.motion.move import Move, Outcome
from crtk_drivers.samples import Value
from crtk_drivers.state import HOMING_COMMANDS, OperatingState
from crtk_drivers.status.board import StatusBoard

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Waiting:
    """A move command that waits."""

    command: Command
    value: Value
    stamp_ns: int
    client: Client
    move: Move


class WaitingMove:
    """Keeps the one move that waits. Thread-safe, under the board's lock.

    Args:
        where: the device, for messages.
        board: told that the device is busy.
        transitions: that are waited for.
        begin: called when the wait is over, in a thread of its own: to find the way may take longer than a
            cycle. It raises CommandRefused.
    """

    def __init__(
        self,
        where: str,
        board: StatusBoard,
        transitions: Transitions,
        begin: Callable[[Waiting], object],
    ) -> None:
        self._where = where
        self._board = board
        self._transitions = transitions
        self._begin = begin
        self._waiting: Waiting | None = None
        self._begins = False

    def put(self, waiting: Waiting) -> bool:
        """Let a move wait, if there is anything to wait for; return whether it does."""
        with self._board.lock:
            if self._transitions.leads_to is not OperatingState.ENABLED:
                return False
            self.end(f"by {waiting.command.name}", Outcome.PREEMPTED, busy=True)
            self._waiting, self._begins = waiting, False
            self._board.move_waits = True
            self._board.update(busy=True)
            return True

    def holds(self, waiting: Waiting) -> bool:
        """Whether `waiting` is still the move that waits. Under the board's lock."""
        return self._waiting is waiting

    def step(self) -> None:
        """Begin when there is nothing left to wait for. I/O thread only."""
        if self._waiting is None or self._begins:
            return
        with self._board.lock:
            waiting = self._waiting
            if waiting is None or self._transitions.running is not None:
                return
            self._begins = True
        thread = threading.Thread(
            target=self._run, args=(waiting,), name=f"{self._where} waiting move", daemon=True
        )
        thread.start()

    def _run(self, waiting: Waiting) -> None:
        name = waiting.command.name
        try:
            self._begin(waiting)
            return
        except CommandRefused as error:
            refusal = error.of(waiting.stamp_ns)
        except Exception as error:
            logger.exception("%s: %s", self._where, name)
            text = f"{type(error).__name__}: {error}"
            refusal = CommandRefused(
                name,
                Reason.INTERNAL_ERROR,
                text,
                where=self._where,
                remedy=REPORT,
                stamp_ns=waiting.stamp_ns,
            )
        with self._board.lock:
            if self.holds(waiting):
                self._board.refused(refusal)
                self.end(str(refusal))

    def replaced_by(self, order: Order) -> None:
        """An order was accepted: that of the move, which waits no longer, or another one, which ends it."""
        if self._waiting is not None:
            with self._board.lock:
                if self._waiting is not None and self._waiting.move is order.move:
                    self._waiting, self._board.move_waits = None, False
                self.end(f"by {order.name}", Outcome.PREEMPTED, busy=order.move is not None)

    def end(self, reason: str, outcome: Outcome = Outcome.ABORTED, *, busy: bool = False) -> None:
        """Forget the move that waits, if one does. From any thread.

        Args:
            reason: in words.
            outcome: of the move.
            busy: another one makes the device busy.
        """
        if self._waiting is None:
            return
        with self._board.lock:
            waiting, self._waiting = self._waiting, None
            self._board.move_waits = False
            if waiting is not None:
                waiting.move.finish(outcome, reason)
                self._board.update(busy=busy or self._transitions.running in HOMING_COMMANDS)
