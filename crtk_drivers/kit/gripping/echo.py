"""Whether a gripper echoes what we have sent it, or what another master has."""

from __future__ import annotations

from typing import Final, Generic, TypeVar

__all__ = ["OTHERS", "Echo"]

CommandT = TypeVar("CommandT")

OTHERS: Final = 0.25
"""Seconds after which an echo that is not of our request is another master's."""


class Echo(Generic[CommandT]):
    """Follows one gripper; no clock.

    Attributes:
        command: that we have sent last; None: none since the connection, or what it does is adopted.
        taken_over: by another master.
    """

    def __init__(self) -> None:
        self.adopt()

    def adopt(self) -> None:
        """What it does now is as if we had sent it."""
        self.command: CommandT | None = None
        self.taken_over = False
        self._strange_since: float | None = None

    def sent(self, command: CommandT) -> None:
        """A command of ours was acknowledged."""
        self.adopt()
        self.command = command

    def see(self, matches: bool, now: float) -> bool:
        """Take whether what is echoed now is what we have sent; return whether the status is about that."""
        if matches:
            self._strange_since = None
            return True
        if self._strange_since is None:
            self._strange_since = now
        self.taken_over = now - self._strange_since > OTHERS
        return False
