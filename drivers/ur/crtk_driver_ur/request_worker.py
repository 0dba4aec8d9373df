"""Requests that wait for the network, in a thread of their own in the control process.

The results are collected by the main loop, which is woken through a file descriptor.
"""

from __future__ import annotations

import os
import queue
import threading
from abc import ABC, abstractmethod
from typing import Any

from crtk_driver_ur.control_frames import CallError, Reply, Request
from crtk_driver_ur.library_calls import explain
from crtk_drivers.errors import CrtkError

__all__ = ["RequestWorker"]


class RequestWorker(ABC):
    """Carries out requests one after the other and hands back their replies.

    Args:
        host: of the controller.
    """

    def __init__(self, host: str) -> None:
        self.host = host
        self._requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[Reply] = queue.SimpleQueue()
        self.wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    def start(self) -> None:
        """Start the thread; it ends with the process."""
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Queue one request."""
        self._requests.put(request)

    def take_replies(self) -> list[Reply]:
        """Return the replies that have come since the last time."""
        try:
            os.eventfd_read(self.wake_fd)
        except BlockingIOError:
            return []
        replies = []
        while not self._replies.empty():
            replies.append(self._replies.get())
        return replies

    @abstractmethod
    def carry_out(self, request: Request) -> Any:
        """Do it and return its value, in the thread of this worker; what it raises is the reply."""

    def _run(self) -> None:
        while True:
            request = self._requests.get()
            self._replies.put(self._reply(request))
            os.eventfd_write(self.wake_fd, 1)

    def _reply(self, request: Request) -> Reply:
        try:
            return Reply(request.sequence, request.name, self.carry_out(request))
        except KeyError as error:
            problem = CallError(request.name, f"argument {error} is missing")
        except CrtkError as error:
            problem = CallError(request.name, error.message, error.remedy)
        except Exception as error:
            problem = explain(request.name, error)
        return Reply(request.sequence, request.name, error=problem)
