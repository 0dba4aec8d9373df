"""Moves: the handle that a client waits on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from typing_extensions import override

from crtk_drivers.errors import MotionAborted
from crtk_drivers.samples import JointState


class Outcome(StrEnum):
    """How a move ended, or that it has not."""

    RUNNING = "running"
    REACHED = "reached"
    PREEMPTED = "pre-empted"
    ABORTED = "aborted"


class Violated(StrEnum):
    """Which tolerance of a trajectory was violated."""

    PATH = "path"
    GOAL = "goal"


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """Where a trajectory stands.

    Attributes:
        time: seconds since it began, of its own.
        desired: where it has the joints now.
        actual: where they are measured.
    """

    time: float
    desired: JointState
    actual: JointState


class Move:
    """An accepted move. Thread-safe.

    Attributes:
        name: the CRTK command, for example ``move_jp``.
        outcome: where it stands.
        reason: why it did not reach its goal, in words.
        violated: the tolerance that ended it; None if none did. Set before it ends.
        progress: of one along a given trajectory, renewed in each cycle; None before it begins.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.outcome = Outcome.RUNNING
        self.reason = ""
        self.violated: Violated | None = None
        self.progress: Progress | None = None
        self._told: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._ended = threading.Event()

    @override
    def __repr__(self) -> str:
        reason = f": {self.reason}" if self.reason else ""
        return f"<{self.name} {self.outcome}{reason}>"

    def finish(self, outcome: Outcome, reason: str = "") -> None:
        """Record the end; the first one counts."""
        with self._lock:
            if not self._ended.is_set():
                self.outcome, self.reason = outcome, reason
                self._ended.set()
                told, self._told = self._told, []
            else:
                told = []
        for tell in told:
            tell()

    def when_ended(self, tell: Callable[[], None]) -> None:
        """Call `tell` when it ends, or now if it has: from whatever thread ends it, so it must not wait."""
        with self._lock:
            if not self._ended.is_set():
                self._told.append(tell)
                return
        tell()

    def is_busy(self) -> bool:
        """Whether it has not ended yet."""
        return not self._ended.is_set()

    def wait(self, timeout: float | None = None, is_busy: bool = False) -> bool:
        """Wait until the move has ended, or with `is_busy` until it has started.

        Args:
            timeout: in seconds; None waits as long as the move takes.
            is_busy: wait for the start instead, which an accepted move already has.

        Returns:
            True when the goal is reached, False when the time is over.

        Raises:
            MotionAborted: it was stopped, pre-empted by another command, or failed.
        """
        if is_busy:
            return True
        if not self._ended.wait(timeout):
            return False
        if self.outcome is not Outcome.REACHED:
            raise MotionAborted(
                f"{self.name} was {self.outcome}" + (f": {self.reason}" if self.reason else "")
            )
        return True
