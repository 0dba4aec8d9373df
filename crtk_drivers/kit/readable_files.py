"""Waiting for one file descriptor, whatever its number."""

from __future__ import annotations

import select
from typing import Final

__all__ = ["is_readable"]

_SELECTABLE: Final = 1024
"""FD_SETSIZE: select takes descriptors below it only (select(2))."""


def is_readable(descriptor: int, timeout: float) -> bool:
    """Return whether there is something to be read, or its end, within `timeout` s; 0 or less: now.

    To the microsecond; in whole milliseconds in a process with more than a thousand open files.

    Raises:
        OSError, ValueError: it is closed.
    """
    wait = max(0.0, timeout)
    if descriptor < _SELECTABLE:
        return bool(select.select((descriptor,), (), (), wait)[0])
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(1000.0 * wait))
