"""Requests that wait for the network, in a thread of their own.

The results are collected by another thread, which may be woken through a file descriptor.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

from crtk_driver_ur.control_requests import CallError, Reply, Request, explain
from crtk_drivers.errors import CrtkError

__all__ = ["Controller", "RequestWorker"]


class Controller(NamedTuple):
    """Whom requests go to.

    Attributes:
        host: address or name.
        version: major and minor version of its software.
        robot_api_port: of its Robot API, if it is PolyScope X.
    """

    host: str
    version: tuple[int, int]
    robot_api_port: int


class RequestWorker(ABC):
    """Carries out requests one after the other and hands back their replies.

    Args:
        controller: whom they go to.
    """

    def __init__(self, controller: Controller) -> None:
        self.controller = controller
        self.host = controller.host
        self._requests: queue.SimpleQueue[Request | None] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[Reply] = queue.SimpleQueue()
        self._stopped = False
        self.wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    def start(self) -> None:
        """Start the thread; it ends after `stop`, and with the process."""
        self._thread.start()

    def stop(self) -> None:
        """Let the thread end: what it waits for is broken off where that is possible. Does not wait."""
        self._stopped = True
        self._requests.put(None)
        self.interrupt()

    def join(self, deadline: float) -> None:
        """Wait for its end, until the monotonic `deadline`."""
        self._thread.join(max(0.0, deadline - time.monotonic()))

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

    def interrupt(self) -> None:  # noqa: B027 - most wait for little
        """Break off what the thread waits for; called from another."""

    def release(self) -> None:  # noqa: B027 - most have nothing
        """Close what is open, in the thread of this worker, as its last act."""

    def _run(self) -> None:
        while (request := self._requests.get()) is not None and not self._stopped:
            self._replies.put(self._reply(request))
            os.eventfd_write(self.wake_fd, 1)
        self.release()
        os.close(self.wake_fd)

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
