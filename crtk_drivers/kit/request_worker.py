"""Requests that wait for the network, in a thread of their own: the I/O thread waits for `read` only.

The results are collected by the I/O thread, which may be woken through a file descriptor.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["RequestWorker"]

Request = TypeVar("Request")
Reply = TypeVar("Reply")


def _nothing() -> None:
    pass


class RequestWorker(Generic[Request, Reply]):
    """Carries out requests one after the other and hands back their replies.

    Args:
        carry_out: does one, in the thread of this worker. It raises nothing: what went wrong is a reply too.
        name: of the thread.
        interrupt: breaks off what the thread waits for; called from another.
        release: closes what is open, in the thread of this worker, as its last act.
    """

    def __init__(
        self,
        carry_out: Callable[[Request], Reply],
        name: str,
        *,
        interrupt: Callable[[], None] = _nothing,
        release: Callable[[], None] = _nothing,
    ) -> None:
        self._carry_out = carry_out
        self._interrupt = interrupt
        self._release = release
        self._requests: queue.SimpleQueue[tuple[Request] | None] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[Reply] = queue.SimpleQueue()
        self._stopped = False
        self.wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread; it ends after `stop`, and with the process."""
        self._thread.start()

    def stop(self) -> None:
        """Let the thread end: what it waits for is broken off where that is possible. Does not wait."""
        self._stopped = True
        self._requests.put(None)
        self._interrupt()

    def join(self, deadline: float) -> None:
        """Wait for its end, until the monotonic `deadline`."""
        self._thread.join(max(0.0, deadline - time.monotonic()))

    def submit(self, request: Request) -> None:
        """Queue one request."""
        self._requests.put((request,))

    def take_replies(self) -> list[Reply]:
        """Return the replies that have come since the last time. Does not wait."""
        if self._replies.empty():  # and so is the descriptor, which counts them
            return []
        try:
            count = os.eventfd_read(self.wake_fd)
        except BlockingIOError:  # it is about to be told
            return []
        return [self._replies.get_nowait() for _ in range(min(count, self._replies.qsize()))]

    def _run(self) -> None:
        while (queued := self._requests.get()) is not None and not self._stopped:
            self._replies.put(self._carry_out(*queued))
            os.eventfd_write(self.wake_fd, 1)
        self._release()
        os.close(self.wake_fd)
