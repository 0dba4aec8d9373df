"""Parts of procedures (`crtk_drivers.device.Steps`), which the I/O thread resumes once a cycle."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Final

__all__ = ["until"]


LATE_LOOKS: Final = 5
"""Cycles in which something that is asked for can be told, if it has come to be so."""


def until(condition: Callable[[], bool], timeout: float) -> Generator[None, None, bool]:
    """Wait until a condition holds, as a part of a procedure: ``done = yield from until(...)``.

    Args:
        condition: looked at once a cycle; what it raises ends the procedure.
        timeout: seconds.

    Returns:
        whether it holds; False when `timeout` is over, and `LATE_LOOKS` cycles more: who was held up has
        not looked for as long.
    """
    deadline, late = time.monotonic() + timeout, 0
    while not condition():
        late += time.monotonic() > deadline
        if late > LATE_LOOKS:
            return False
        yield
    return True
