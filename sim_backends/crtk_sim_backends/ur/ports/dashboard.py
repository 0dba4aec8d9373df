"""The dashboard server on port 29999: one line in, one line out, all commands in one table.

Source: UR "Dashboard Server e-Series" and "Dashboard Server CB-Series" articles. Clients match the
replies by regular expression, so they are the specification.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from crtk_sim_backends.ur.program.programs import PROGRAM_FOLDER, ProgramError
from crtk_sim_backends.ur.safety.modes import RobotMode, RuntimeState, SafetyMode
from crtk_sim_backends.ur.versions import ALWAYS, E_SERIES, Since, Version

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller
    from crtk_sim_backends.ur.models import RobotModel

log = logging.getLogger(__name__)

GREETING: Final = b"Connected: Universal Robots Dashboard Server\n"
NOT_IN_REMOTE_CONTROL: Final = (
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and "
    "reconnect to port 29999"
)
MAX_LINE: Final = 4096


@dataclass(frozen=True)
class Robot:
    """What the dashboard can tell about the robot, beside the state of its controller."""

    controller: Controller
    model: RobotModel
    version: Version
    serial_number: str
    shut_down: Callable[[], None]


@dataclass(frozen=True)
class Command:
    """One dashboard command.

    `pattern` matches the whole line, upper or lower case; its first group is the argument that
    `answer` gets, "" when it has none. `since` is the first software that knows it. `local` tells
    that it works in local control too.
    """

    pattern: re.Pattern[str]
    answer: Callable[[Robot, str], str]
    since: Since
    local: bool


def _boolean(value: bool) -> str:
    return "true" if value else "false"


def _program(robot: Robot) -> str:
    return robot.controller.programs.loaded.rsplit("/", 1)[-1] or "<unnamed>"


def _load(robot: Robot, name: str) -> str:
    try:
        robot.controller.load_program(name)
    except FileNotFoundError:
        return f"File not found: {name}"
    except ProgramError as error:
        log.warning("%s cannot be loaded: %s", name, error)
        return f"Error while loading program: {name}"
    return f"Loading program: {name if name.startswith('/') else PROGRAM_FOLDER + name}"


def _load_installation(robot: Robot, name: str) -> str:
    try:
        robot.controller.load_installation(name)
    except FileNotFoundError:
        return f"File not found: {name}"
    except ProgramError as error:
        log.warning("%s cannot be loaded: %s", name, error)
        return f"Failed to load installation: {name}"
    return f"Loading installation: {name}"


def _loaded_program(robot: Robot, _: str) -> str:
    name = robot.controller.programs.loaded
    return f"Loaded program: {PROGRAM_FOLDER}{name}" if name else "No program loaded"


def _play(robot: Robot, _: str) -> str:
    return "Starting program" if robot.controller.play() else "Failed to execute: play"


def _pause(robot: Robot, _: str) -> str:
    return "Pausing program" if robot.controller.pause() else "Failed to execute: pause"


def _stop(robot: Robot, _: str) -> str:
    robot.controller.stop()
    return "Stopped"


def _power_on(robot: Robot, _: str) -> str:
    robot.controller.power_on()
    return "Powering on"


def _power_off(robot: Robot, _: str) -> str:
    robot.controller.power_off()
    return "Powering off"


def _brake_release(robot: Robot, _: str) -> str:
    robot.controller.brake_release()
    return "Brake releasing"


def _unlock(robot: Robot, _: str) -> str:
    if not robot.controller.unlock_protective_stop():
        return (
            "Cannot unlock protective stop until 5s after occurrence. "
            "Always inspect cause of protective stop before unlocking"
        )
    return "Protective stop releasing"


def _restart_safety(robot: Robot, _: str) -> str:
    robot.controller.restart_safety()
    return "Restarting safety"


def _popup(robot: Robot, text: str) -> str:
    robot.controller.popup_text = text
    return "showing popup"


def _close_popup(robot: Robot, _: str) -> str:
    robot.controller.close_popup()
    return "closing popup"


_PROGRAM_STATES: Final = {
    RuntimeState.PLAYING: "PLAYING",
    RuntimeState.RESUMING: "PLAYING",
    RuntimeState.PAUSING: "PAUSED",
    RuntimeState.PAUSED: "PAUSED",
}


def _program_state(robot: Robot, _: str) -> str:
    state = _PROGRAM_STATES.get(robot.controller.runtime_state, "STOPPED")
    return f"{state} {_program(robot)}"


def _running(robot: Robot, _: str) -> str:
    state = _PROGRAM_STATES.get(robot.controller.runtime_state)
    return f"Program running: {_boolean(state == 'PLAYING')}"


def _version_text(robot: Robot, _: str) -> str:
    return "URSoftware {}.{}.{}.{} (Jan 01 2025)".format(*robot.version)


def _set_operational_mode(robot: Robot, mode: str) -> str:
    mode = mode.upper()
    if mode == "NONE" or not robot.controller.set_operational_mode(mode):
        return f"Failed setting operational mode: {mode}"
    return f"Operational mode {mode} is set"


_USER_ROLES: Final = ("PROGRAMMER", "OPERATOR", "NONE", "LOCKED", "RESTRICTED")


def _set_user_role(robot: Robot, role: str) -> str:
    if role.upper() not in _USER_ROLES:
        return f"Failed setting user role: {role}"
    robot.controller.user_role = role.upper()
    return f"Setting user role: {role}"


_SHOWN_AS: Final = {
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: SafetyMode.SAFEGUARD_STOP,
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP: SafetyMode.SAFEGUARD_STOP,
}
"""What `safetymode` calls the modes that only `safetystatus` knows."""


def _safety_mode(robot: Robot, _: str) -> str:
    mode = robot.controller.safety_mode
    return f"Safetymode: {_SHOWN_AS.get(mode, mode).name}"


def _clear_operational_mode(robot: Robot, _: str) -> str:
    robot.controller.set_operational_mode("NONE")
    mode = "MANUAL" if robot.controller.safety.manual else "AUTOMATIC"
    return f"No longer controlling the operational mode. Current operational mode: '{mode}'."


def _add_to_log(robot: Robot, text: str) -> str:
    if not text:
        return "No log message to add"
    robot.controller.note(text)
    return "Added log message"


def _shut_down(robot: Robot, _: str) -> str:
    robot.shut_down()
    return "Shutting down"


def _command(
    pattern: str,
    answer: Callable[[Robot, str], str] | str,
    since: Since = ALWAYS,
    local: bool = False,
) -> Command:
    if isinstance(answer, str):
        text = answer
        answer = lambda _robot, argument: text.format(argument)  # noqa: E731
    return Command(re.compile(pattern, re.IGNORECASE), answer, since, local)


_LOCAL: Final = True

COMMANDS: Final[tuple[Command, ...]] = (
    _command(r"load installation (.+)", _load_installation, Since((3, 2))),
    _command(r"load (.+)", _load),
    _command(r"play", _play),
    _command(r"stop", _stop),
    _command(r"pause", _pause),
    _command(r"quit", "Disconnected", local=_LOCAL),
    _command(r"shutdown", _shut_down),
    _command(r"running", _running, local=_LOCAL),
    _command(
        r"robotmode",
        lambda robot, _: f"Robotmode: {RobotMode(robot.controller.robot_mode).name}",
        local=_LOCAL,
    ),
    _command(r"safetymode", _safety_mode, local=_LOCAL),
    _command(
        r"safetystatus",
        lambda robot, _: f"Safetystatus: {SafetyMode(robot.controller.safety_mode).name}",
        Since((3, 11), (5, 4)),
        _LOCAL,
    ),
    _command(r"programState", _program_state, local=_LOCAL),
    _command(r"get loaded program", _loaded_program, local=_LOCAL),
    _command(
        r"isProgramSaved",
        lambda robot, _: f"{_boolean(bool(robot.controller.programs.loaded))} {_program(robot)}",
        local=_LOCAL,
    ),
    _command(r"PolyscopeVersion", _version_text, local=_LOCAL),
    _command(r"version", lambda robot, _: "{}.{}.{}.{}".format(*robot.version), E_SERIES, _LOCAL),
    _command(
        r"get serial number", lambda robot, _: robot.serial_number, Since((3, 12), (5, 6)), _LOCAL
    ),
    _command(
        r"get robot model",
        lambda robot, _: robot.model.title.removesuffix("e"),
        Since((3, 12), (5, 6)),
        _LOCAL,
    ),
    _command(
        r"is in remote control",
        lambda robot, _: _boolean(robot.controller.remote),
        Since(None, (5, 6)),
        _LOCAL,
    ),
    _command(r"power on", _power_on),
    _command(r"power off", _power_off),
    _command(r"brake release", _brake_release),
    _command(r"unlock protective stop", _unlock, Since((3, 1))),
    _command(r"restart safety", _restart_safety, Since((3, 7), (5, 1))),
    _command(r"close safety popup", "closing safety popup", Since((3, 1))),
    _command(r"close popup", _close_popup, local=_LOCAL),
    _command(r"popup ?(.*)", _popup, local=_LOCAL),
    _command(r"addToLog ?(.*)", _add_to_log, local=_LOCAL),
    _command(r"saveLog", "Log saved to disk", Since((3, 13), (5, 8)), _LOCAL),
    _command(r"set operational mode (.+)", _set_operational_mode, E_SERIES, _LOCAL),
    _command(
        r"get operational mode",
        lambda robot, _: robot.controller.operational_mode,
        Since(None, (5, 6)),
        _LOCAL,
    ),
    _command(r"clear operational mode", _clear_operational_mode, E_SERIES, _LOCAL),
    _command(r"setUserRole (.+)", _set_user_role, Since((3, 1), None, None)),
    _command(
        r"getUserRole", lambda robot, _: robot.controller.user_role, Since((3, 1), None, None)
    ),
    _command(
        r"generate flight report ?(.*)",
        "Flight Report generated with id: 00000000-0000-4000-8000-000000000001",
        Since((3, 13), (5, 8)),
        _LOCAL,
    ),
    _command(
        r"generate support file (.+)",
        "Completed successfully: {}/ursupport.zip",
        Since((3, 13), (5, 8)),
        _LOCAL,
    ),
)


class DashboardSession:
    """One dashboard client: bytes in, bytes out; `note` is called with every command."""

    def __init__(self, robot: Robot, note: Callable[[str], object]) -> None:
        self._robot = robot
        self._note = note
        self._buffer = bytearray()
        self.ended = False  # the client said quit

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers to the lines that they complete."""
        self._buffer += data
        answers = []
        while not self.ended and (end := self._buffer.find(b"\n")) >= 0:
            line = " ".join(self._buffer[:end].decode("utf-8", "replace").split())
            del self._buffer[: end + 1]
            if line:
                answers.append(self.answer(line))
        if len(self._buffer) > MAX_LINE:
            self._buffer.clear()
        return "".join(f"{answer}\n" for answer in answers).encode()

    def answer(self, line: str) -> str:
        """Do the command of one line and return the reply to it."""
        self._note(line)
        for command in COMMANDS:
            match = command.pattern.fullmatch(line)
            if match and command.since.reached_by(self._robot.version):
                if not (command.local or self._robot.controller.obeys_clients):
                    return NOT_IN_REMOTE_CONTROL
                self.ended = line.lower() == "quit"
                return command.answer(self._robot, match.group(1) if match.re.groups else "")
        return f"could not understand: '{line}'"

    def close(self) -> None:
        """Forget an unfinished line."""
        self._buffer.clear()
