"""Signs of life between two processes: each hears when the other one stands still.

A process that is stopped (SIGSTOP, a frozen container, a debugger) keeps its files open. Whoever waits for
the end of its connection never hears of that.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from typing import Final

PERIOD: Final = 0.1
"""Seconds between two signs of life."""

LONGEST_LOOK: Final = 0.5
"""Seconds that count at most from one look to the next: who looks may have stood still itself."""


def pulse_ends() -> tuple[socket.socket, socket.socket]:
    """Return two ends of a way for signs of life; one is given to another process."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)


class Pulse:
    """One end: it gives signs of life, once started, and listens for those of the other end. Thread-safe.

    Args:
        end: of the two; it belongs to the pulse.
    """

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._silent = 0.0
        self._looked = time.monotonic()
        self.has_begun = False
        """Something was heard: the other process has started."""
        self.has_ended = False
        """The other process has closed its end."""
        end.setblocking(False)

    @classmethod
    def start(cls, end: socket.socket) -> Pulse:
        """Return one that gives signs of life in a thread of its own, until the other process has ended."""
        pulse = cls(end)
        threading.Thread(target=pulse._give, name="pulse", daemon=True).start()
        return pulse

    def silence(self) -> float:
        """Return the seconds for which nothing was heard, as far as this process ran meanwhile."""
        with self._lock:
            now = time.monotonic()
            self._silent += min(now - self._looked, LONGEST_LOOK)
            self._looked = now
            with contextlib.suppress(OSError):
                while self._end.recv(4096):
                    self._silent, self.has_begun = 0.0, True
                self.has_ended = True
            return self._silent

    def close(self) -> None:
        """Give no more signs of life. May be called twice."""
        with self._lock:
            self._closed.set()
            self._end.close()

    def _give(self) -> None:
        while not self._closed.wait(PERIOD):
            with self._lock:
                if self._closed.is_set():
                    return
                try:
                    self._end.send(b".")
                except BlockingIOError:
                    continue  # the other process stands still
                except OSError:
                    return
