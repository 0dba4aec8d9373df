"""Whether what waits in the present thread is to be given up: the program ends while a device is opened.

The core says so around `Device.open`; the transports of the kit ask. So an `open` that waits by them ends at
once, and a driver need not see to it. What waits by other means ends by `Device.abort_open`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

__all__ = ["GIVEN_UP", "given_up_by", "is_given_up"]

GIVEN_UP: Final = "given up: the driver is being shut down"

_here = threading.local()


@contextmanager
def given_up_by(asked: Callable[[], bool]) -> Iterator[None]:
    """Let what waits in this thread be given up as soon as `asked` says so, until the block ends."""
    _here.asked = asked
    try:
        yield
    finally:
        del _here.asked


def is_given_up() -> bool:
    """Return whether what waits in this thread is to be given up."""
    asked: Callable[[], bool] | None = getattr(_here, "asked", None)
    return asked is not None and asked()
