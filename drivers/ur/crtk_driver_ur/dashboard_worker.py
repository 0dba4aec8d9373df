"""Dashboard commands in a thread of their own, because an answer may take up to 2.5 s.

Only this thread touches the library's DashboardClient (its calls release the interpreter lock). The
results are collected by the main loop, which is woken through a file descriptor.
"""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from crtk_driver_ur.control_frames import CallError, Reply, Request
from crtk_driver_ur.library_calls import explain

__all__ = ["DASHBOARD_METHODS", "DashboardWorker"]

CONNECT_TIMEOUT_MS = 2000

DASHBOARD_METHODS: Mapping[str, tuple[str, Sequence[str]]] = MappingProxyType(
    {
        "power_on": ("powerOn", ()),
        "power_off": ("powerOff", ()),
        "brake_release": ("brakeRelease", ()),
        "unlock_protective_stop": ("unlockProtectiveStop", ()),
        "restart_safety": ("restartSafety", ()),
        "close_popup": ("closePopup", ()),
        "close_safety_popup": ("closeSafetyPopup", ()),
        "play": ("play", ()),
        "stop_program": ("stop", ()),
        "pause_program": ("pause", ()),
        "is_in_remote_control": ("isInRemoteControl", ()),
        "polyscope_version": ("polyscopeVersion", ()),
        "serial_number": ("getSerialNumber", ()),
        "robot_model": ("getRobotModel", ()),
        "robot_mode": ("robotmode", ()),
        "safety_mode": ("safetymode", ()),
        "safety_status": ("safetystatus", ()),
        "program_state": ("programState", ()),
        "loaded_program": ("getLoadedProgram", ()),
        "popup": ("popup", ("text",)),
        "add_to_log": ("addToLog", ("text",)),
    }
)
"""Request name: method of the DashboardClient and the names of its arguments."""


class DashboardWorker:
    """Runs dashboard requests one after the other and hands back their replies.

    Args:
        host: of the controller.
    """

    def __init__(self, host: str) -> None:
        self._host = host
        self._requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[Reply] = queue.SimpleQueue()
        self._client: Any = None
        self.wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name="dashboard", daemon=True)

    def start(self) -> None:
        """Start the thread; it ends with the process."""
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Queue one request whose name is in `DASHBOARD_METHODS`."""
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

    def _run(self) -> None:
        while True:
            self._replies.put(self._carry_out(self._requests.get()))
            os.eventfd_write(self.wake_fd, 1)

    def _carry_out(self, request: Request) -> Reply:
        method, names = DASHBOARD_METHODS[request.name]
        try:
            client = self._connected()
            value = getattr(client, method)(*(request.arguments[name] for name in names))
        except KeyError as error:
            missing = CallError(method, f"argument {error} is missing")
            return Reply(request.sequence, request.name, error=missing)
        except Exception as error:
            # A late answer to this command must not be taken for the answer to the next.
            self._client = None
            return Reply(request.sequence, request.name, error=explain(method, error))
        return Reply(request.sequence, request.name, value)

    def _connected(self) -> Any:
        from dashboard_client import DashboardClient

        if self._client is None or not self._client.isConnected():
            self._client = DashboardClient(self._host)
            self._client.connect(CONNECT_TIMEOUT_MS)
        return self._client
