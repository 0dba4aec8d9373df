"""The request to end, which a signal handler may make."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


class StopRequest:
    """Set once, looked at again and again. It takes no lock, as `threading.Event` does.

    A signal handler interrupts the main thread anywhere, also where that holds the lock of an event, or in
    another handler that does: it would wait for itself for ever.
    """

    def __init__(self) -> None:
        self._is_set = False

    def set(self) -> None:
        """Set it; from anywhere."""
        self._is_set = True

    def is_set(self) -> bool:
        """Whether it was set."""
        return self._is_set


@contextmanager
def end_signals(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Call `handler` at SIGINT and SIGTERM within; then what was called before is called again."""
    before = {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handled in before.items():
            signal.signal(number, handled)


@contextmanager
def stop_signals() -> Iterator[StopRequest]:
    """Within, SIGINT and SIGTERM set the request."""
    stop = StopRequest()
    with end_signals(lambda *_: stop.set()):
        yield stop
