"""The request to end, which a signal handler may make."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType
from typing import Any

INTERRUPTED = 130
"""The exit code after Ctrl-C, as of any program that a signal ends."""


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
    """Call `handler` at SIGINT, SIGTERM and SIGHUP within; then what was called before is called again.

    SIGHUP comes when the terminal is closed or its network lost. Under ``nohup`` it stays ignored.
    """
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, handled in before.items():
            signal.signal(number, handled)


@contextmanager
def stop_signals() -> Iterator[StopRequest]:
    """Within, SIGINT, SIGTERM and SIGHUP set the request."""
    stop = StopRequest()
    with end_signals(lambda *_: stop.set()):
        yield stop


def left_at_interrupt() -> AbstractContextManager[None]:
    """Within, SIGINT ends the process at once: while it imports, and there is nothing to be closed.

    Usually it raises KeyboardInterrupt, and who imports may lose that: what Python calls when a lock of its
    imports goes is one of the places where an exception is printed and forgotten. Where SIGINT is handled
    otherwise already, or this is not the main thread, nothing is changed.
    """
    return _interrupt_handled(signal.default_int_handler, _leave)


def raised_at_interrupt() -> AbstractContextManager[None]:
    """Within, SIGINT raises KeyboardInterrupt where it would end the process: see `left_at_interrupt`."""
    return _interrupt_handled(_leave, signal.default_int_handler)


def _leave(number: int, frame: FrameType | None) -> None:
    os._exit(INTERRUPTED)


@contextmanager
def _interrupt_handled(
    before: object, within: Callable[[int, FrameType | None], Any]
) -> Iterator[None]:
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not before:
        yield
        return
    handled = signal.signal(signal.SIGINT, within)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handled)
