"""What the dashboard server answers, by software version and by remote control and operational mode.

Sources: UR's articles on the dashboard server, and the patterns by which Universal_Robots_Client_Library
takes an answer for a good one, with the software from which on it asks. Without sockets.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from crtk_sim_backends.ur.messages import ErrorMessage
from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.ports.dashboard import (
    COMMANDS,
    NOT_IN_REMOTE_CONTROL,
    DashboardSession,
    Robot,
)
from crtk_sim_backends.ur.safety.modes import RobotMode, RuntimeState, SafetyMode
from crtk_sim_backends.ur.versions import E_SERIES, Since
from rigs.ur_controller import Bench

WORDS: list[tuple[str, str, Since]] = [
    ("load simulation.urp", r"Loading program: .*simulation\.urp", Since()),
    ("get loaded program", r"Loaded program: .*simulation\.urp", Since()),
    ("programState", r"STOPPED simulation\.urp", Since()),
    ("isProgramSaved", r"(true|false) .*\.urp", Since()),
    ("play", "Starting program", Since()),
    ("running", "Program running: true", Since()),
    ("programState", r"PLAYING simulation\.urp", Since()),
    ("pause", "Pausing program", Since()),
    ("programState", r"PAUSED simulation\.urp", Since()),
    ("play", "Starting program", Since()),
    ("running", "Program running: true", Since()),
    ("stop", "Stopped", Since()),
    ("running", "Program running: false", Since()),
    ("load nothing.urp", r"File not found: nothing\.urp", Since()),
    (
        "load installation default.installation",
        r"Loading installation: .*default\.inst.*",
        Since((3, 2)),
    ),
    ("robotmode", "Robotmode: RUNNING", Since()),
    ("safetymode", "Safetymode: NORMAL", Since()),
    ("safetystatus", "Safetystatus: NORMAL", Since((3, 11), (5, 4))),
    ("popup hello", "showing popup", Since()),
    ("close popup", "closing popup", Since()),
    ("close safety popup", "closing safety popup", Since((3, 1))),
    ("unlock protective stop", "Protective stop releasing", Since((3, 1))),
    ("addToLog My message", "Added log message", Since()),
    ("addToLog", "No log message to add", Since()),
    ("saveLog", "Log saved to disk", Since((3, 13), (5, 8))),
    ("PolyscopeVersion", r"URSoftware \d+\.\d+\.\d+\.\d+ \(.*\)", Since()),
    ("version", r"\d+\.\d+\.\d+\.\d+", E_SERIES),
    ("get serial number", r"20\d+", Since((3, 12), (5, 6))),
    ("get robot model", r"UR\d+", Since((3, 12), (5, 6))),
    ("is in remote control", "true", Since(None, (5, 6))),
    ("set operational mode automatic", "Operational mode AUTOMATIC is set", E_SERIES),
    ("set operational mode none", "Failed setting operational mode: NONE", E_SERIES),
    ("get operational mode", "AUTOMATIC", Since(None, (5, 6))),
    ("clear operational mode", r"No longer controlling the operational mode\. .*", E_SERIES),
    ("get operational mode", "NONE", Since(None, (5, 6))),
    ("setUserRole operator", "Setting user role: operator", Since((3, 1), None, None)),
    ("getUserRole", "OPERATOR", Since((3, 1), None, None)),
    ("generate flight report", "Flight Report generated with id:.*", Since((3, 13), (5, 8))),
    ("generate support file .", r"Completed successfully: ?\..*", Since((3, 13), (5, 8))),
    ("power off", "Powering off", Since()),
    ("power on", "Powering on", Since()),
    ("brake release", "Brake releasing", Since()),
    ("restart safety", "Restarting safety", Since((3, 7), (5, 1))),
    ("shutdown", "Shutting down", Since()),
    ("unknown_command", "could not understand: 'unknown_command'", Since()),
    ("quit", "Disconnected", Since()),
]
"""Commands in an order in which they succeed, what they are answered, and since which software."""

VERSIONS = [
    ("ur5", (3, 2, 0, 0)),
    ("ur5", (3, 5, 0, 0)),
    ("ur3", (3, 12, 0, 0)),
    ("ur10", (3, 15, 8, 0)),
    ("ur5e", (5, 0, 0, 0)),
    ("ur5e", (5, 5, 1, 0)),
    ("ur5e", (5, 9, 4, 0)),
    ("ur5e", (5, 12, 4, 0)),
    ("ur20", (5, 26, 3, 0)),
]
MOVING = "while True:\n speedj([0.3, 0, 0, 0, 0, 0], 5, 0.1)\nend"


class Desk:
    """A dashboard client of a controller in virtual time."""

    def __init__(self, model: str = "ur5e", **options: object) -> None:
        self.bench = Bench(model, **options)  # type: ignore[arg-type]
        controller = self.bench.controller
        robot = Robot(controller, MODELS[model], controller.version, "20235500001", lambda: None)
        self._session = DashboardSession(robot, lambda _: None)

    def ask(self, line: str) -> str:
        """Send a line; a control period later its effect can be seen."""
        (answer,) = self._session.receive(f"{line}\n".encode()).decode().splitlines()
        self.bench.ticks(1)
        return answer


@pytest.mark.parametrize(("model", "version"), VERSIONS)
def test_every_command_has_its_words_and_its_first_software(
    model: str, version: tuple[int, ...]
) -> None:
    desk = Desk(model, version=version)
    for command, words, since in WORDS:
        known = since.reached_by(version)
        expected = words if known else re.escape(f"could not understand: '{command}'")
        answer = desk.ask(command)
        assert re.fullmatch(expected, answer), (command, answer)


def test_no_command_is_left_out() -> None:
    asked = [command for command, _, _ in WORDS]
    for command in COMMANDS:
        assert any(command.pattern.fullmatch(line) for line in asked), command.pattern.pattern


# Remote control and operational modes.

NEEDS_CONTROL = (
    "load simulation.urp",
    "load installation default.installation",
    "play",
    "stop",
    "pause",
    "shutdown",
    "power on",
    "power off",
    "brake release",
    "unlock protective stop",
    "restart safety",
    "close safety popup",
)
NEEDS_NONE = (
    "running",
    "robotmode",
    "safetymode",
    "safetystatus",
    "programState",
    "get loaded program",
    "isProgramSaved",
    "PolyscopeVersion",
    "version",
    "get serial number",
    "get robot model",
    "is in remote control",
    "get operational mode",
    "popup hello",
    "close popup",
    "addToLog hello",
    "saveLog",
)
MODES: list[tuple[tuple[str, ...], str, bool]] = [
    ((), "NONE", False),
    (("set operational mode automatic",), "AUTOMATIC", False),
    (("set operational mode manual",), "MANUAL", True),
    (("set operational mode manual", "clear operational mode"), "NONE", True),
    (("set operational mode automatic", "clear operational mode"), "NONE", False),
    (("set operational mode manual", "set operational mode automatic"), "AUTOMATIC", False),
]
"""What a client did, what it controls then, and whether the robot is in manual mode."""


@pytest.mark.parametrize("enforced", [True, False])
@pytest.mark.parametrize("remote", [True, False])
@pytest.mark.parametrize(("done", "controls", "manual"), MODES)
def test_who_may_do_what(
    done: tuple[str, ...], controls: str, manual: bool, remote: bool, enforced: bool
) -> None:
    def desk() -> Desk:
        found = Desk(version=(5, 12, 4, 0), remote=remote, remote_enforced=enforced)
        for line in done:
            found.ask(line)
        return found

    has_control = remote and not manual
    asking = desk()
    assert asking.ask("get operational mode") == controls
    assert asking.ask("is in remote control") == str(has_control).lower()
    for line in NEEDS_NONE:
        assert asking.ask(line) != NOT_IN_REMOTE_CONTROL, line
    for line in NEEDS_CONTROL:
        refused = desk().ask(line) == NOT_IN_REMOTE_CONTROL
        assert refused is (enforced and not has_control), line


@pytest.mark.parametrize("remote", [True, False])
@pytest.mark.parametrize(("done", "controls", "manual"), MODES)
def test_scripts_go_by_the_same(
    done: tuple[str, ...], controls: str, manual: bool, remote: bool
) -> None:
    desk = Desk(version=(5, 12, 4, 0), remote=remote)
    for line in done:
        desk.ask(line)
    desk.bench.start("sleep(0.1)")
    desk.bench.ticks(1)
    obeyed = desk.bench.controller.runtime_state == RuntimeState.PLAYING
    assert obeyed is (remote and not manual)
    codes = [message.code for message in desk.bench.of_type(ErrorMessage)]
    assert codes == ([] if obeyed else [210])


def test_both_modes_need_an_answer_to_be_cleared() -> None:
    desk = Desk(version=(5, 12, 4, 0))
    for mode in ("MANUAL", "AUTOMATIC"):
        desk.ask(f"set operational mode {mode.lower()}")
        assert desk.ask("clear operational mode").endswith(f"operational mode: '{mode}'.")
    assert desk.ask("set operational mode other") == "Failed setting operational mode: OTHER"


# What ends a stop.

Press = Callable[[Bench], object]
CAUSES: dict[str, Press] = {
    "protective": lambda b: b.controller.protective_stop(),
    "violation": lambda b: b.controller.violation(),
    "fault": lambda b: b.controller.fault(),
    "emergency": lambda b: b.controller.emergency_stop(),
    "system": lambda b: b.controller.emergency_stop(SafetyMode.SYSTEM_EMERGENCY_STOP),
    "safeguard": lambda b: b.controller.safeguard_stop(True),
    "recovery": lambda b: b.controller.recovery_mode(True),
    "reduced": lambda b: b.controller.reduced_mode(True),
}
ENDED: dict[str, set[str]] = {
    "unlock protective stop": {"protective"},
    "restart safety": {"protective", "violation", "fault"},
    "close safety popup": set(),
    "close popup": set(),
    "stop": set(),
    "power on": set(),
    "brake release": set(),
}
"""Causes that a command ends, once the lock is over."""


@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.parametrize("command", ENDED)
def test_what_a_command_ends(command: str, cause: str) -> None:
    desk = Desk(version=(5, 12, 4, 0), lock_seconds=0.1)
    bench = desk.bench
    bench.start(MOVING)
    bench.seconds(0.1)
    CAUSES[cause](bench)
    bench.seconds(0.3)
    before = bench.controller.safety_mode
    assert before != SafetyMode.NORMAL
    desk.ask(command)
    ends = cause in ENDED[command]
    assert bench.controller.safety_mode == (SafetyMode.NORMAL if ends else before)


@pytest.mark.parametrize("line", ["set unlock protective stop", "unlock protective stop"])
@pytest.mark.parametrize("cause", CAUSES)
def test_what_the_script_ports_end(line: str, cause: str) -> None:
    bench = Bench()
    CAUSES[cause](bench)
    bench.seconds(0.1)
    before = bench.controller.safety_mode
    bench.controller.run_script(line)
    ends = cause == "protective"
    assert bench.controller.safety_mode == (SafetyMode.NORMAL if ends else before)


def test_after_an_unlock_the_robot_runs_and_its_program_has_to_be_started_again() -> None:
    desk = Desk(version=(5, 12, 4, 0))
    desk.ask("load simulation.urp")
    desk.ask("play")
    desk.bench.controller.protective_stop()
    desk.bench.seconds(0.1)
    assert desk.ask("play") == "Failed to execute: play"
    assert desk.ask("unlock protective stop").startswith("Cannot unlock protective stop until 5s")
    desk.bench.seconds(5.0)
    assert desk.ask("unlock protective stop") == "Protective stop releasing"
    assert desk.ask("robotmode") == "Robotmode: RUNNING"
    assert desk.ask("programState") == "STOPPED simulation.urp"
    assert desk.ask("play") == "Starting program"


def test_an_unlock_leaves_what_else_holds() -> None:
    desk = Desk(version=(5, 12, 4, 0), lock_seconds=0.1)
    controller = desk.bench.controller
    controller.protective_stop()
    controller.safeguard_stop(True)
    desk.bench.seconds(0.2)
    assert desk.ask("safetystatus") == "Safetystatus: SAFEGUARD_STOP"
    desk.ask("unlock protective stop")
    assert desk.ask("safetystatus") == "Safetystatus: SAFEGUARD_STOP"
    controller.safeguard_stop(False)
    assert desk.ask("safetystatus") == "Safetystatus: NORMAL"
    assert controller.robot_mode == RobotMode.RUNNING
