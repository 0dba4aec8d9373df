"""Lets clients' threads wait for what the I/O thread does, which never waits for them."""

from __future__ import annotations

import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Lock

__all__ = ["Turns"]


class Turns:
    """Wakes those who wait whenever the I/O thread has done something."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._waiting: tuple[SimpleQueue[None], ...] = ()

    def turn(self) -> None:
        """Wake all. For the I/O thread: it takes no lock."""
        for waiting in self._waiting:
            waiting.put(None)

    def wait_for(self, test: Callable[[], object], timeout: float) -> bool:
        """Wait until `test` holds after something was done; return whether it did within `timeout` s."""
        if test():
            return True
        deadline = time.monotonic() + timeout
        turned: SimpleQueue[None] = SimpleQueue()
        with self._lock:
            self._waiting = (*self._waiting, turned)
        try:
            while not test():
                turned.get(timeout=max(0.0, deadline - time.monotonic()))
        except Empty:
            return bool(test())
        finally:
            with self._lock:
                self._waiting = tuple(other for other in self._waiting if other is not turned)
        return True
