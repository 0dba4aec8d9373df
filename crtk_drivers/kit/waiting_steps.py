"""Parts of procedures (`crtk_drivers.device.Steps`), which the I/O thread resumes once a cycle."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator

__all__ = ["until"]


def until(condition: Callable[[], bool], timeout: float) -> Generator[None, None, bool]:
    """Wait until a condition holds, as a part of a procedure: ``done = yield from until(...)``.

    Args:
        condition: looked at once a cycle; what it raises ends the procedure.
        timeout: seconds.

    Returns:
        whether it holds; False when `timeout` is over.
    """
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        yield
    return True
