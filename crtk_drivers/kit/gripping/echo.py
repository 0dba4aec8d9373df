"""Whether a gripper echoes what we have sent it, or what another master has."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Hashable
from typing import Final, Generic, TypeVar

__all__ = ["OTHERS", "Echo"]

CommandT = TypeVar("CommandT")

OTHERS: Final = 0.25
"""Seconds after which an echo that is not of our request is another master's."""
LATE: Final = 1.0
"""Seconds in which a command of ours that was replaced may come once more, doubled by a gateway."""


class Echo(Generic[CommandT]):
    """Follows one gripper; `is_in_doubt` alone asks the clock.

    Args:
        told: return what a gripper echoes of a command.

    Attributes:
        command: that we have sent last; None: none since the connection, or what it does is adopted.
        taken_over: by another master, or by a command of ours that came late.
    """

    def __init__(self, told: Callable[[CommandT], Hashable]) -> None:
        self._told = told
        self._last: CommandT | None = None
        self._replaced: dict[Hashable, float] = {}
        self.begin()

    def begin(self) -> None:
        """A connection begins: whoever commands it may."""
        self.adopt()
        self._is_ours = False

    def adopt(self) -> None:
        """What it does now is as if we had sent it."""
        self.command: CommandT | None = None
        self.taken_over = self._is_late = False
        self._is_ours = True
        self._adopted: Hashable | None = None
        self._strange_since: float | None = None

    def sent(self, command: CommandT, now: float) -> None:
        """A command of ours was acknowledged."""
        before, self._last = self._last, command
        self.adopt()
        self.command = command
        self._replaced = {told: at for told, at in self._replaced.items() if now - at < LATE}
        if before is not None:
            self._replaced[self._told(before)] = now
        self._replaced.pop(self._told(command), None)

    def see(self, echo: Hashable, offered: CommandT | None, now: float) -> bool:
        """Take what is echoed now; return whether the status is about what we have sent.

        Args:
            echo: of a command, by whomever.
            offered: a command of ours that may have come, though nothing has acknowledged it.
            now: monotonic seconds.
        """
        if self._is_known(echo, offered):
            self._strange_since = None
            return True
        if self._strange_since is None:
            self._strange_since = now
            self._is_late = now - self._replaced.get(echo, -math.inf) < LATE
        self.taken_over = now - self._strange_since > OTHERS
        return False

    def _is_known(self, echo: Hashable, offered: CommandT | None) -> bool:
        if self.command is not None:
            commands = self.command, offered
            return any(command is not None and echo == self._told(command) for command in commands)
        if self._adopted is None:
            self._adopted = echo
        known = not self._is_ours or echo == self._adopted
        return known or (offered is not None and echo == self._told(offered))

    @property
    def is_others(self) -> bool:
        """Whether what it does is another master's, and not a command of ours that came late."""
        return self.taken_over and not self._is_late

    @property
    def is_in_doubt(self) -> bool:
        """Whether what it echoes is not ours, for less time than tells who has sent it."""
        since = self._strange_since
        return since is not None and not self.taken_over and time.monotonic() - since < 2.0 * OTHERS
