"""Dashboard commands in a thread of their own, because an answer may take up to 2.5 s.

Only this thread touches the library's DashboardClient (its calls release the interpreter lock).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from crtk_driver_ur.control_frames import Request
from crtk_driver_ur.request_worker import RequestWorker

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


class DashboardWorker(RequestWorker):
    """For requests whose names are in `DASHBOARD_METHODS`."""

    def __init__(self, host: str) -> None:
        super().__init__(host)
        self._client: Any = None

    def carry_out(self, request: Request) -> Any:
        """See the base class."""
        method, names = DASHBOARD_METHODS[request.name]
        arguments = [request.arguments[name] for name in names]
        try:
            return getattr(self._connected(), method)(*arguments)
        except Exception:
            # A late answer to this command must not be taken for the answer to the next.
            self._client = None
            raise

    def _connected(self) -> Any:
        from dashboard_client import DashboardClient

        if self._client is None or not self._client.isConnected():
            self._client = DashboardClient(self.host)
            self._client.connect(CONNECT_TIMEOUT_MS)
        return self._client
