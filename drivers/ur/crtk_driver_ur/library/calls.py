"""Guarded calls of the ur_rtde library: timed, announced if they may block, errors explained."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from crtk_driver_ur.control_requests import CallError, explain

COMMAND_ALLOWANCE = 1.0
"""Seconds that a command with a handshake may block before the process counts as hung."""


class LibraryError(Exception):
    """A library call that raised or was refused."""

    def __init__(self, error: CallError) -> None:
        super().__init__(f"{error.call}: {error.text}")
        self.error = error


class LibraryCalls:
    """The methods of one library object, by name.

    Args:
        target: the library object.
        announce: told the name and the allowed seconds of a call that may block, before it begins.
    """

    def __init__(self, target: Any, announce: Callable[[str, float], None]) -> None:
        self._target = target
        self._announce = announce
        self._longest = 0.0

    def take_longest(self) -> float:
        """Return the seconds of the longest call since this was last asked."""
        longest, self._longest = self._longest, 0.0
        return longest

    def read(self, name: str) -> Any:
        """Call a method that only reads what the library already has.

        Raises:
            LibraryError: it raised.
        """
        try:
            return getattr(self._target, name)()
        except Exception as error:
            raise LibraryError(explain(name, error)) from error

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a method and return its value.

        Raises:
            LibraryError: it raised.
        """
        start = time.monotonic()
        try:
            return getattr(self._target, name)(*arguments)
        except Exception as error:
            raise LibraryError(explain(name, error)) from error
        finally:
            self._longest = max(self._longest, time.monotonic() - start)

    def realtime(self, name: str, *arguments: Any) -> None:
        """Call a method that sends one package and does not wait for its execution.

        Raises:
            LibraryError: it raised or was refused.
        """
        if not self.call(name, *arguments):
            raise LibraryError(_refused(name))

    def command(self, name: str, *arguments: Any) -> None:
        """Call a method that waits until the control program has done what was asked.

        Raises:
            LibraryError: it raised or was refused.
        """
        self._announce(name, COMMAND_ALLOWANCE)
        if not self.call(name, *arguments):
            raise LibraryError(_refused(name))

    def blocking(self, name: str, *arguments: Any, allowed: float = COMMAND_ALLOWANCE) -> Any:
        """Call a method that waits and whose value says nothing about success.

        Raises:
            LibraryError: it raised.
        """
        self._announce(name, allowed)
        return self.call(name, *arguments)


def _refused(name: str) -> CallError:
    return CallError(
        name,
        "the library returned False: the control program does not run on the controller",
        "Look for a protective stop or a message on the teach pendant, then enable again.",
    )
