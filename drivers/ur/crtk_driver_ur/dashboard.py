"""The dashboard server: one line of text out, one line back. Blocking, for a thread of its own.

Source: Universal Robots, "Dashboard Server e-Series" and "Dashboard Server CB-Series".
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from crtk_drivers.errors import (
    ConnectionFailed,
    ConnectionLost,
    DeviceError,
    TransitionFailed,
)
from crtk_drivers.kit import LineDecoder, MessageLink, TcpTransport

__all__ = ["DASHBOARD_PORT", "REQUESTS", "DashboardClient"]

DASHBOARD_PORT: Final = 29999
TIMEOUT: Final = 2.5
"""Seconds for the connection, and for each answer."""
LOAD_TIMEOUT: Final = 20.0
"""Seconds for a program and its installation to be loaded."""
LONGEST_LINE: Final = 4096


class DashboardRequest(NamedTuple):
    """A line, how the answer to it begins if it is done, the argument behind it if any, and seconds."""

    line: str
    done: str = ""
    argument: str = ""
    timeout: float = TIMEOUT


REQUESTS: Final[Mapping[str, DashboardRequest]] = MappingProxyType(
    {
        "power_on": DashboardRequest("power on", "Powering on"),
        "power_off": DashboardRequest("power off", "Powering off"),
        "brake_release": DashboardRequest("brake release", "Brake releasing"),
        "unlock_protective_stop": DashboardRequest(
            "unlock protective stop", "Protective stop releasing"
        ),
        "restart_safety": DashboardRequest("restart safety", "Restarting safety"),
        "close_popup": DashboardRequest("close popup", "closing popup"),
        "close_safety_popup": DashboardRequest("close safety popup", "closing safety popup"),
        "load_program": DashboardRequest("load", "Loading program", "text", LOAD_TIMEOUT),
        "load_installation": DashboardRequest(
            "load installation", "Loading installation", "text", LOAD_TIMEOUT
        ),
        "play_program": DashboardRequest("play", "Starting program"),
        "resume_program": DashboardRequest("play", "Starting program"),
        "stop_program": DashboardRequest("stop", "Stopped"),
        "pause_program": DashboardRequest("pause", "Pausing program"),
        "popup": DashboardRequest("popup", "showing popup", "text"),
        "add_to_log": DashboardRequest("addToLog", "Added log message", "text"),
        "save_log": DashboardRequest("saveLog", "Log saved"),
        "shut_down": DashboardRequest("shutdown", "Shutting down"),
        "is_in_remote_control": DashboardRequest("is in remote control"),
        "operational_mode": DashboardRequest("get operational mode"),
        "polyscope_version": DashboardRequest("PolyscopeVersion"),
        "serial_number": DashboardRequest("get serial number"),
        "robot_model": DashboardRequest("get robot model"),
        "robot_mode": DashboardRequest("robotmode"),
        "safety_mode": DashboardRequest("safetymode"),
        "safety_status": DashboardRequest("safetystatus"),
        "program_state": DashboardRequest("programState"),
        "loaded_program": DashboardRequest("get loaded program"),
    }
)
"""What may be asked for, by our name of it."""

_REMEDY: Final = (
    "Check the address, and that the controller has finished starting; "
    "PolyScope X has no dashboard server."
)

_TRUTH: Final = {"true": True, "false": False}


class DashboardClient:
    """Connects when it is first used, and anew after whatever went wrong.

    Args:
        host: address or name of the controller.
        port: of the dashboard server.
    """

    def __init__(self, host: str, port: int = DASHBOARD_PORT) -> None:
        self._transport = TcpTransport(host, port, "dashboard", _REMEDY)
        self._link = MessageLink(self._transport, _lines)
        self._lines: deque[str] = deque()

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def interrupt(self) -> None:
        """Let an answer that is awaited fail, and all later ones. From another thread."""
        self._transport.abort()

    def ask(self, name: str, arguments: Mapping[str, Any] = MappingProxyType({})) -> str | bool:
        """Carry out a request of `REQUESTS` and return the answer; yes and no as True and False.

        Raises:
            ConnectionFailed: there is no dashboard server, or it is silent.
            ConnectionLost: it went away; the request may have been carried out or not.
            TransitionFailed: it answers that it does not do that.
        """
        request = REQUESTS[name]
        line = f"{request.line} {arguments[request.argument]}" if request.argument else request.line
        answer = self._exchange(" ".join(line.split()), request.timeout)
        refused = answer.startswith("could not understand")
        if refused or not answer.lower().startswith(request.done.lower()):
            raise TransitionFailed(
                f"the controller answers {answer!r} to {request.line!r}",
                where=self._transport.where,
                remedy="Look at the teach pendant; it may have control, or a pop-up may be open.",
            )
        return _TRUTH.get(answer, answer)

    def _exchange(self, line: str, timeout: float) -> str:
        if not self._transport.is_open:
            self._connect()
        try:
            # Lines that nobody asked for: each answer belongs to the line before it.
            self._link.forget()
            self._lines.clear()
            self._link.write(f"{line}\n".encode())
            return self._read_line(timeout)
        except DeviceError as error:
            # A late answer to this line must not be taken for the answer to the next.
            self.close()
            raise ConnectionLost(
                f"no answer to {line!r}: {error.message}",
                where=self._transport.where,
                remedy="The controller does not answer: check the network and the controller.",
            ) from error

    def _connect(self) -> None:
        self._lines.clear()
        self._link.open(time.monotonic() + TIMEOUT)
        try:
            self._read_line(TIMEOUT)  # the greeting
        except DeviceError as error:
            self.close()
            raise ConnectionFailed(
                f"cannot connect: {error.message}", where=self._transport.where, remedy=_REMEDY
            ) from error

    def _read_line(self, timeout: float) -> str:
        if not self._lines:
            self._lines += self._link.read(time.monotonic() + timeout)
        if not self._lines:
            raise ConnectionLost("timed out")
        return self._lines.popleft()


def _lines() -> LineDecoder[str]:
    return LineDecoder(
        str.strip, longest=LONGEST_LINE, encoding="utf-8", errors="replace", strict=True
    )
