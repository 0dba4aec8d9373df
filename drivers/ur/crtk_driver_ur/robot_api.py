"""The Robot API of PolyScope X: what the dashboard server was before, as JSON over HTTP. Blocking.

Source of paths, keys and the software that has them: Universal_Robots_Client_Library, the dashboard client
for PolyScope X.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping
from contextlib import suppress
from http.client import HTTPConnection, HTTPException
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from crtk_drivers.errors import ConnectionFailed, ConnectionLost, TransitionFailed

__all__ = ["POLYSCOPE_X", "REMOTE_SINCE", "REQUESTS", "RobotApiClient"]

Version = tuple[int, int]

POLYSCOPE_X: Final[Version] = (10, 0)
FIRST: Final[Version] = (10, 11)
"""Software that has the Robot API."""
REMOTE_SINCE: Final[Version] = (10, 12)
"""Software from which on it tells whether the robot is in remote control."""

BASE: Final = "/universal-robots/robot-api"
CONNECT_TIMEOUT: Final = 2.5
TIMEOUT: Final = 15.0
"""Seconds for an answer, which comes when the command is done."""
LONGEST: Final = 1 << 16
"""Bytes of an answer."""


class ApiRequest(NamedTuple):
    """One request.

    Attributes:
        method, path, body: of HTTP; the body becomes JSON.
        key: of the text in the body, if it has one.
        answer: what is told, with keys of the answer in braces.
        since: software that has it.
    """

    method: str
    path: str
    body: Mapping[str, str] = MappingProxyType({})
    key: str = ""
    answer: str = "{message}"
    since: Version = FIRST


def _robot(action: str) -> ApiRequest:
    return ApiRequest("PUT", "/robotstate/v1/state", {"action": action})


def _program(action: str) -> ApiRequest:
    return ApiRequest("PUT", "/program/v1/state", {"action": action})


def _question(path: str, answer: str, since: Version = (10, 12)) -> ApiRequest:
    return ApiRequest("GET", path, answer=answer, since=since)


_LATER: Final[Version] = (10, 14)

REQUESTS: Final[Mapping[str, ApiRequest]] = MappingProxyType(
    {
        "power_on": _robot("POWER_ON"),
        "power_off": _robot("POWER_OFF"),
        "brake_release": _robot("BRAKE_RELEASE"),
        "unlock_protective_stop": _robot("UNLOCK_PROTECTIVE_STOP"),
        "restart_safety": _robot("RESTART_SAFETY"),
        "play_program": _program("play"),
        "resume_program": _program("resume"),
        "pause_program": _program("pause"),
        "stop_program": _program("stop"),
        "load_program": ApiRequest("PUT", "/program/v1/loaded", key="name", since=(10, 12)),
        "popup": ApiRequest("POST", "/popup/v1", key="message", since=_LATER),
        "close_popup": ApiRequest("DELETE", "/popup/v1", since=_LATER),
        "close_safety_popup": ApiRequest("DELETE", "/popup/v1/safety", since=_LATER),
        "add_to_log": ApiRequest("POST", "/system/v1/log", key="message", since=_LATER),
        "shut_down": ApiRequest("PUT", "/system/v1/shutdown", since=_LATER),
        "is_in_remote_control": _question("/system/v1/controlmode", "{mode}"),
        "robot_mode": _question("/robotstate/v1/robotmode", "{mode}"),
        "safety_mode": _question("/robotstate/v1/safetymode", "{mode}"),
        "program_state": _question("/program/v1/state", "{state}", FIRST),
        "loaded_program": _question("/program/v1/loaded", "Loaded program: {name}"),
        "operational_mode": _question("/system/v1/operationalmode", "{mode}"),
        "polyscope_version": _question("/versions/v1", "{marketingVersion}", _LATER),
        "robot_model": _question("/system/v1/information", "{robotType}", _LATER),
        "serial_number": _question("/system/v1/information", "{serialNumber}", _LATER),
    }
)
"""What may be asked for, by the names of `crtk_driver_ur.dashboard.REQUESTS`."""

_LOAD_BEFORE: Final = ApiRequest("PUT", "/program/v1/load", key="programName")
"""`load_program` of 10.11."""

_TRUTH: Final = {"REMOTE": True, "LOCAL": False}


class RobotApiClient:
    """Connects anew for each request.

    Args:
        host: address or name of the controller.
        port: of the Robot API.
        version: of its software.
    """

    def __init__(self, host: str, port: int, version: Version) -> None:
        self._address = (host, port)
        self._version = version
        self._where = f"Robot API {host}:{port}"
        self._connection: HTTPConnection | None = None

    def close(self) -> None:
        """Nothing is open between two requests."""

    def interrupt(self) -> None:
        """Let an answer that is awaited fail at once. From another thread."""
        connection = self._connection
        peer = None if connection is None else connection.sock
        if peer is not None:
            with suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)

    def ask(self, name: str, arguments: Mapping[str, Any] = MappingProxyType({})) -> str | bool:
        """Carry out a request and return the answer; remote and local control as True and False.

        Raises:
            ConnectionFailed: there is no Robot API.
            ConnectionLost: it is silent or went away; the request may have been carried out or not.
            TransitionFailed: it answers that it does not do that, or its software cannot.
        """
        request = self._request(name)
        body = dict(request.body)
        if request.key:
            body[request.key] = str(arguments["text"])
        status, content = self._exchange(request.method, request.path, body)
        if status >= 300:
            raise TransitionFailed(
                f"the controller answers {content.get('message', status)!r} to {name!r}",
                where=self._where,
                remedy="Look at the teach pendant; it may have control.",
            )
        try:
            answer = request.answer.format_map({"message": "OK", **content})
        except KeyError as error:
            raise TransitionFailed(
                f"the answer to {name!r} has no {error}",
                where=self._where,
                remedy="Report it with the version of the controller's software.",
            ) from error
        return _TRUTH.get(answer, answer)

    def _request(self, name: str) -> ApiRequest:
        if name == "load_program" and FIRST <= self._version < REQUESTS[name].since:
            return _LOAD_BEFORE
        request = REQUESTS.get(name)
        if request is None or self._version < request.since:
            needs = "PolyScope X does not offer it"
            if request is not None:
                needed, present = ("{}.{}".format(*v) for v in (request.since, self._version))
                needs = f"it needs PolyScope {needed}, and this is {present}"
            raise TransitionFailed(
                f"{name}: {needs}", where=self._where, remedy="Do it on the teach pendant."
            )
        return request

    def _exchange(
        self, method: str, path: str, body: Mapping[str, str]
    ) -> tuple[int, dict[str, Any]]:
        self._connection = connection = HTTPConnection(*self._address, timeout=CONNECT_TIMEOUT)
        try:
            self._connect(connection)
            data = json.dumps(body) if body else None
            headers = {"Content-Type": "application/json", "Connection": "close"}
            connection.request(method, f"{BASE}{path}", data, headers)
            response = connection.getresponse()
            content = json.loads(response.read(LONGEST) or b"{}")
        except (OSError, HTTPException, ValueError) as error:
            if isinstance(error, ConnectionFailed):
                raise
            raise ConnectionLost(
                f"no answer to {method} {path}: {error}",
                where=self._where,
                remedy="The controller does not answer: check the network and the controller.",
            ) from error
        finally:
            self._connection = None
            connection.close()
        return response.status, content if isinstance(content, dict) else {}

    def _connect(self, connection: HTTPConnection) -> None:
        try:
            connection.connect()
        except OSError as error:
            raise ConnectionFailed(
                f"cannot connect: {error}",
                where=self._where,
                remedy="Check the address, and that the controller has finished starting; PolyScope X "
                "has the Robot API from 10.11 on.",
            ) from error
        connection.sock.settimeout(TIMEOUT)
