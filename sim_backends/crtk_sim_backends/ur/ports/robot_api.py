"""The Robot API of PolyScope X: what the dashboard server was before, as JSON over HTTP.

Source: the client for it in Universal_Robots_Client_Library (dashboard_client_implementation_x).
Not simulated: setting the operational mode, which that client cannot either.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from email.parser import BytesParser
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import unquote

from crtk_sim_backends.ur.program.programs import ProgramError, UploadedProgram
from crtk_sim_backends.ur.safety.modes import RobotMode, RuntimeState, SafetyMode
from crtk_sim_backends.ur.versions import Version

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller
    from crtk_sim_backends.ur.ports.dashboard import Robot

BASE: Final = "/universal-robots/robot-api"
PATIENCE: Final = 9.0  # s that a command may take; clients wait for ten
MAX_HEAD: Final = 1 << 14  # bytes
MAX_BODY: Final = 1 << 20
DEFAULT_PROGRAM: Final = "Default program"  # what is loaded when nothing was

API_VERSIONS: Final = (((10, 11), "3.0.0"), ((10, 12), "3.1.4"), ((10, 14), "5.0.107"))
"""Version of the interface from that software on."""

PROGRAMS: Final = "/programs/v1"
SUPPORT_FILES: Final = "/supportfiles/v1"
EMPTY_ZIP: Final = b"PK\x05\x06" + bytes(18)

Handler = Callable[["RobotApiSession", bytes], dict[str, Any] | None]

_REASONS: Final = {
    200: "OK",
    400: "Bad Request",
    403: "Forbidden",
    404: "Not Found",
    405: "Method Not Allowed",
    409: "Conflict",
    411: "Length Required",
    413: "Payload Too Large",
}


class RequestError(Exception):
    """A request that is refused with an HTTP status."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


@dataclass(frozen=True)
class Command:
    """What a request starts: `begin` False is a conflict; it is answered once `done`."""

    begin: Callable[[Controller], object]
    done: Callable[[Controller], bool]


def api_version(software: Version) -> str:
    """Version of the interface of a software."""
    return next(text for since, text in reversed(API_VERSIONS) if software[:2] >= since)


def _in_mode(*modes: RobotMode) -> Callable[[Controller], bool]:
    return lambda controller: controller.robot_mode in modes


def _in_state(*states: RuntimeState) -> Callable[[Controller], bool]:
    return lambda controller: controller.runtime_state in states


ROBOT_ACTIONS: Final[Mapping[str, Command]] = {
    "POWER_ON": Command(
        lambda c: c.power_on(), _in_mode(RobotMode.IDLE, RobotMode.BACKDRIVE, RobotMode.RUNNING)
    ),
    "POWER_OFF": Command(lambda c: c.power_off(), _in_mode(RobotMode.POWER_OFF)),
    "BRAKE_RELEASE": Command(lambda c: c.brake_release(), _in_mode(RobotMode.RUNNING)),
    "RESTART_SAFETY": Command(lambda c: c.restart_safety(), lambda c: True),
    # Asked again every period, for it is refused during the first five seconds of the stop.
    "UNLOCK_PROTECTIVE_STOP": Command(lambda c: True, lambda c: c.unlock_protective_stop()),
}
PROGRAM_ACTIONS: Final[Mapping[str, Command]] = {
    "play": Command(lambda c: c.play(), _in_state(RuntimeState.PLAYING)),
    "pause": Command(lambda c: c.pause(), _in_state(RuntimeState.PAUSED)),
    "resume": Command(lambda c: c.player.resume(), _in_state(RuntimeState.PLAYING)),
    "stop": Command(lambda c: c.stop(), _in_state(RuntimeState.STOPPED)),
}

_SAFETY_NAMES: Final = {
    SafetyMode.ROBOT_EMERGENCY_STOP: "EMERGENCY_STOP",
    SafetyMode.SYSTEM_EMERGENCY_STOP: "EMERGENCY_STOP",
    SafetyMode.VIOLATION: "FAULT",
}
_PROGRAM_STATES: Final = {
    RuntimeState.PLAYING: "PLAYING",
    RuntimeState.RESUMING: "PLAYING",
    RuntimeState.PAUSING: "PAUSED",
    RuntimeState.PAUSED: "PAUSED",
}


def _program_name(robot: Robot) -> str:
    name = robot.controller.programs.loaded.rsplit("/", 1)[-1]
    return name.rsplit(".", 1)[0] or DEFAULT_PROGRAM


QUESTIONS: Final[Mapping[str, Callable[[Robot], dict[str, Any]]]] = {
    "/openapi.json": lambda robot: {
        "openapi": "3.0.0",
        "info": {"title": "Robot API", "version": api_version(robot.version)},
        "paths": {},
    },
    "/robotstate/v1/robotmode": lambda robot: {"mode": robot.controller.robot_mode.name},
    "/robotstate/v1/safetymode": lambda robot: {
        "mode": _SAFETY_NAMES.get(robot.controller.safety_mode, robot.controller.safety_mode.name)
    },
    "/program/v1/state": lambda robot: {
        "state": _PROGRAM_STATES.get(robot.controller.runtime_state, "STOPPED")
    },
    "/program/v1/loaded": lambda robot: {"name": _program_name(robot)},
    "/programs/v1": lambda robot: {
        "programs": [
            {
                "name": name.rsplit(".", 1)[0],
                "description": "",
                "createdDate": None,
                "lastModifiedDate": None,
                "lastSavedDate": None,
                "programState": "FINAL",
            }
            for name in robot.controller.programs.names()
        ]
    },
    "/system/v1/controlmode": lambda robot: {
        "mode": "REMOTE" if robot.controller.remote else "LOCAL"
    },
    "/system/v1/operationalmode": lambda robot: {
        "mode": "MANUAL" if robot.controller.safety.manual else "AUTOMATIC"
    },
    "/system/v1/information": lambda robot: {
        "robotType": robot.model.title,
        "serialNumber": robot.serial_number,
    },
    "/versions/v1": lambda robot: {
        "marketingVersion": "{}.{}.{}".format(*robot.version),
        "baselineVersion": "{}.{}.{}.{}".format(*robot.version),
    },
}
"""What GET answers, by path. All of it works in local control, too."""


class RobotApiSession:
    """One HTTP connection, kept open from request to request.

    Attributes:
        waiting: a command is not done yet: call `receive` again in the next period.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._buffer = bytearray()
        self._content_type = ""
        self._done: Callable[[Controller], bool] | None = None
        self._deadline = 0.0
        self.ended = False

    @property
    def waiting(self) -> bool:
        """Whether a command is not done yet, so that `receive` has to be called every period."""
        return self._done is not None

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers to the requests that are complete."""
        self._buffer += data
        answers = b""
        while not self.ended:
            answer = self._next() if self._done is None else self._finish()
            if answer is None:
                break
            answers += answer
        return answers

    def close(self) -> None:
        """Forget an unfinished request."""
        self._buffer.clear()
        self._done = None

    def _next(self) -> bytes | None:
        """Do the next request; None when none is complete, or it takes time."""
        try:
            request = self._cut()
            if request is None:
                return None
            method, path, body = request
            answer = self._do(method, unquote(path).removeprefix(BASE).rstrip("/"), body)
        except RequestError as error:
            return _response(error.status, {"message": str(error)})
        return None if self._done is not None else _response(200, answer)

    def _cut(self) -> tuple[str, str, bytes] | None:
        """Cut one request out of the buffer: method, path and body; None when none is complete."""
        end = self._buffer.find(b"\r\n\r\n")
        if end < 0:
            self._refuse_when(len(self._buffer) > MAX_HEAD, 413, "the request is too long")
            return None
        lines = self._buffer[:end].decode("latin-1").split("\r\n")
        words = lines[0].split(" ")
        headers = dict(_header(line) for line in lines[1:])
        self._refuse_when(len(words) != 3 or not words[2].startswith("HTTP/1."), 400, "no HTTP")
        self._refuse_when("transfer-encoding" in headers, 411, "the length is needed")
        length = headers.get("content-length", "0")
        self._refuse_when(not length.isdecimal(), 400, "the length is no number")
        size = int(length[:9])
        self._refuse_when(size > MAX_BODY, 413, "the request is too long")
        if len(self._buffer) < end + 4 + size:
            return None
        body = bytes(self._buffer[end + 4 : end + 4 + size])
        del self._buffer[: end + 4 + size]
        self._content_type = headers.get("content-type", "")
        return words[0], words[1].partition("?")[0], body

    def _refuse_when(self, condition: bool, status: int, reason: str) -> None:
        """Refuse what makes the rest of the stream unreadable, and end the connection."""
        if condition:
            self.ended = True
            raise RequestError(status, reason)

    def _do(self, method: str, path: str, body: bytes) -> dict[str, Any] | bytes:
        if method == "GET":
            if path == SUPPORT_FILES:
                return EMPTY_ZIP
            program = path.removeprefix(f"{PROGRAMS}/")
            if program != path:
                return self._download(program)
            if path not in QUESTIONS:
                raise RequestError(404, f"there is no {path}")
            return QUESTIONS[path](self._robot)
        handler = self._HANDLERS.get((method, path))
        if handler is None:
            status = 405 if path in QUESTIONS else 404
            raise RequestError(status, f"there is no {method} {path}")
        return handler(self, body) or {"message": "OK"}

    def _check_remote(self) -> None:
        if not self._robot.controller.obeys_clients:
            raise RequestError(403, "The robot is not in remote control")

    def _robot_action(self, body: bytes) -> None:
        self._begin(ROBOT_ACTIONS, _text(body, "action"))

    def _program_action(self, body: bytes) -> None:
        self._begin(PROGRAM_ACTIONS, _text(body, "action"))

    def _begin(self, actions: Mapping[str, Command], name: str) -> None:
        self._check_remote()
        if name not in actions:
            raise RequestError(400, f"action must be one of {', '.join(actions)}, not {name}")
        controller = self._robot.controller
        if actions[name].begin(controller) is False:
            state = f"{controller.robot_mode.name}, {controller.safety_mode.name}"
            raise RequestError(
                409, f"{name} is not possible: {state}, {controller.runtime_state.name}"
            )
        self._done = actions[name].done
        self._deadline = controller.time + PATIENCE

    def _shut_down(self, _: bytes) -> None:
        self._check_remote()
        self._robot.shut_down()

    def _popup(self, body: bytes) -> None:
        self._robot.controller.popup_text = _text(body, "message")

    def _close_popup(self, _: bytes) -> None:
        self._robot.controller.close_popup()

    def _close_safety_popup(self, _: bytes) -> None:
        """There is none to close."""

    def _add_to_log(self, body: bytes) -> None:
        self._robot.controller.note(_text(body, "message"))

    def _generate_support_files(self, _: bytes) -> None:
        """There is nothing to put into them."""

    def _upload(self, body: bytes) -> dict[str, Any]:
        program = self._uploaded(body)
        programs = self._robot.controller.programs
        if program.name in programs.names():
            raise RequestError(400, f"there is a program {_short(program.name)} already")
        programs.upload(program)
        return {"programName": _short(program.name)}

    def _update(self, body: bytes) -> dict[str, Any]:
        program = self._uploaded(body)
        programs = self._robot.controller.programs
        if programs.uploaded(program.name) is None:
            raise RequestError(404, f"no program {_short(program.name)} was uploaded")
        programs.upload(program)
        return {"programName": _short(program.name)}

    def _uploaded(self, body: bytes) -> UploadedProgram:
        """Program in the part `file` of a form."""
        head = f"Content-Type: {self._content_type}\r\n\r\n".encode("latin-1", "replace")
        for part in BytesParser().parsebytes(head + body).walk():
            content = part.get_payload(decode=True)
            named = part.get_param("name", header="content-disposition")
            if named == "file" and isinstance(content, bytes):
                try:
                    return UploadedProgram(json.loads(content))
                except (ValueError, RecursionError) as error:
                    raise RequestError(400, f"the file is no JSON: {error}") from error
                except ProgramError as error:
                    raise RequestError(400, f"the file is no program: {error}") from error
        raise RequestError(400, "the body must be a form with a file")

    def _download(self, name: str) -> dict[str, Any]:
        program = self._robot.controller.programs.uploaded(f"{name}.urp")
        if program is None:
            raise RequestError(404, f"no program {name} was uploaded")
        return dict(program.content)

    def _finish(self) -> bytes | None:
        """Answer to the command under way once it is done or has taken too long."""
        controller = self._robot.controller
        if self._done is None:
            return None
        if self._done(controller):
            self._done = None
            return _response(200, {"message": "OK"})
        if controller.time < self._deadline:
            return None
        self._done = None
        return _response(409, {"message": f"not done within {PATIENCE:g} s"})

    def _load(self, body: bytes) -> None:
        self._load_program(_text(body, "name"))

    def _load_in_10_11(self, body: bytes) -> None:
        self._load_program(_text(body, "programName"))

    def _load_program(self, name: str) -> None:
        self._check_remote()
        for candidate in (name, f"{name}.urp", f"{name}.script"):
            try:
                self._robot.controller.load_program(candidate)
            except FileNotFoundError:
                continue
            except ProgramError as error:
                raise RequestError(409, f"{name} cannot be loaded: {error}") from error
            return
        raise RequestError(404, f"there is no program {name}")

    _HANDLERS: Final[Mapping[tuple[str, str], Handler]] = {
        ("PUT", "/robotstate/v1/state"): _robot_action,
        ("PUT", "/program/v1/state"): _program_action,
        ("PUT", "/program/v1/loaded"): _load,
        ("PUT", "/program/v1/load"): _load_in_10_11,
        ("PUT", "/system/v1/shutdown"): _shut_down,
        ("POST", "/popup/v1"): _popup,
        ("DELETE", "/popup/v1"): _close_popup,
        ("DELETE", "/popup/v1/safety"): _close_safety_popup,
        ("POST", "/system/v1/log"): _add_to_log,
        ("POST", PROGRAMS): _upload,
        ("PUT", PROGRAMS): _update,
        ("POST", SUPPORT_FILES): _generate_support_files,
    }


def _short(name: str) -> str:
    return name.removesuffix(".urp")


def _header(line: str) -> tuple[str, str]:
    name, _, value = line.partition(":")
    return name.strip().lower(), value.strip()


def _text(body: bytes, key: str) -> str:
    """Text of one key of a JSON object."""
    try:
        value = json.loads(body)[key]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RequestError(400, f"the body must be a JSON object with {key}") from error
    if not isinstance(value, str):
        raise RequestError(400, f"{key} must be text")
    return value


def _response(status: int, content: dict[str, Any] | bytes) -> bytes:
    kind, body = "zip", content
    if not isinstance(body, bytes):
        kind, body = "json", json.dumps(content).encode()
    head = (
        f"HTTP/1.1 {status} {_REASONS[status]}\r\n"
        f"Content-Type: application/{kind}\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    return head.encode() + body
