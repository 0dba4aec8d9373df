"""The dashboard: replies, refusals in local control, and what older software does not know."""

import pytest

from crtk_sim_backends.ur import SIM, ConfigError
from rigs.ur_clients import DashboardClient, PrimaryClient
from rigs.waiting import eventually


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn() as running:
        yield running


@pytest.fixture
def dashboard(sim):
    with DashboardClient(sim.host) as client:
        yield client


def test_it_greets(dashboard):
    assert dashboard.greeting == "Connected: Universal Robots Dashboard Server"


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("PolyscopeVersion", "URSoftware 5.12.4.0 (Jan 01 2025)"),
        ("version", "5.12.4.0"),
        ("get serial number", "20235500001"),
        ("get robot model", "UR5"),
        ("is in remote control", "true"),
        ("robotmode", "Robotmode: RUNNING"),
        ("ROBOTMODE", "Robotmode: RUNNING"),
        ("safetymode", "Safetymode: NORMAL"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("running", "Program running: false"),
        ("programState", "STOPPED <unnamed>"),
        ("get loaded program", "No program loaded"),
        ("isProgramSaved", "false <unnamed>"),
        ("play", "Failed to execute: play"),
        ("pause", "Failed to execute: pause"),
        ("stop", "Stopped"),
        ("unlock protective stop", "Protective stop releasing"),
        ("close safety popup", "closing safety popup"),
        ("close popup", "closing popup"),
        ("popup hello there", "showing popup"),
        ("popup", "showing popup"),
        ("addToLog something", "Added log message"),
        ("saveLog", "Log saved to disk"),
        ("load installation default.installation", "Loading installation: default.installation"),
        ("get operational mode", "NONE"),
        ("set operational mode automatic", "Operational mode AUTOMATIC is set"),
        ("set operational mode none", "Failed setting operational mode: NONE"),
        ("load installation other.installation", "File not found: other.installation"),
        ("load missing.urp", "File not found: missing.urp"),
        ("addToLog", "No log message to add"),
        ("generate support file .", "Completed successfully: ./ursupport.zip"),
        ("no such thing", "could not understand: 'no such thing'"),
        ("getUserRole", "could not understand: 'getUserRole'"),
        ("load", "could not understand: 'load'"),
    ],
)
def test_replies(dashboard, command, reply):
    assert dashboard.ask(command) == reply


def test_lines_may_be_split_joined_and_end_in_crlf(dashboard):
    for byte in b"robotmode\r\nsafety":
        dashboard.send(bytes([byte]))
    dashboard.send(b"mode\n\n   \nrunning\n")
    assert [dashboard.line() for _ in range(3)] == [
        "Robotmode: RUNNING",
        "Safetymode: NORMAL",
        "Program running: false",
    ]


def test_log_and_pop_up_can_be_looked_at(sim, dashboard):
    dashboard.ask("addToLog  cell door opened")
    dashboard.ask("popup close the door")
    status = eventually(lambda: (now := sim.control.status())["popup"] == "close the door" and now)
    assert status["log"][-1]["text"] == "cell door opened"
    with PrimaryClient(sim.host) as primary:
        primary.send(b"nothing_such()\n")
        primary.message(10)
    assert "name_not_found:nothing_such" in sim.control.status()["log"][-1]["text"]
    dashboard.ask("close popup")
    assert sim.control.status()["popup"] is None


def test_quit_closes_the_connection(dashboard):
    assert dashboard.ask("quit") == "Disconnected"
    assert dashboard.closed_by_peer()


def test_power_off_power_on_and_brake_release():
    with SIM.spawn(powered_on=False) as sim, DashboardClient(sim.host) as dashboard:
        assert dashboard.ask("robotmode") == "Robotmode: POWER_OFF"
        assert dashboard.ask("power on") == "Powering on"
        eventually(lambda: dashboard.ask("robotmode") == "Robotmode: IDLE")
        assert dashboard.ask("brake release") == "Brake releasing"
        eventually(lambda: dashboard.ask("robotmode") == "Robotmode: RUNNING")
        assert dashboard.ask("power off") == "Powering off"
        eventually(lambda: dashboard.ask("robotmode") == "Robotmode: POWER_OFF")


def test_a_program_is_loaded_played_paused_and_stopped(sim):
    with DashboardClient(sim.host) as dashboard:
        assert (
            dashboard.ask("load external_control.urp")
            == "Loading program: /programs/external_control.urp"
        )
        assert (
            dashboard.ask("get loaded program") == "Loaded program: /programs/external_control.urp"
        )
        assert dashboard.ask("programState") == "STOPPED external_control.urp"
        assert dashboard.ask("play") == "Starting program"
        eventually(lambda: dashboard.ask("programState") == "PLAYING external_control.urp")
        assert dashboard.ask("running") == "Program running: true"
        assert dashboard.ask("pause") == "Pausing program"
        eventually(lambda: dashboard.ask("programState") == "PAUSED external_control.urp")
        assert dashboard.ask("running") == "Program running: false"
        assert dashboard.ask("play") == "Starting program"
        # While it speeds up again already (tests of UR's client library, which ask at once).
        assert dashboard.ask("running") == "Program running: true"
        assert dashboard.ask("programState") == "PLAYING external_control.urp"
        eventually(lambda: dashboard.ask("programState") == "PLAYING external_control.urp")
        assert dashboard.ask("stop") == "Stopped"
        eventually(lambda: dashboard.ask("programState") == "STOPPED external_control.urp")


def test_a_protective_stop_cannot_be_unlocked_at_once():
    with SIM.spawn(lock_seconds=1.0) as sim, DashboardClient(sim.host) as dashboard:

        def is_locked():  # unless whoever asks was held up for so long
            sim.control.inject("protective_stop")
            assert dashboard.ask("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
            answer = dashboard.ask("unlock protective stop")
            return answer.startswith("Cannot unlock protective stop")

        eventually(is_locked)
        answers = []
        eventually(
            lambda: (
                answers.append(dashboard.ask("unlock protective stop"))
                or answers[-1] == "Protective stop releasing"
            ),
        )
        eventually(lambda: dashboard.ask("safetystatus") == "Safetystatus: NORMAL")


@pytest.mark.parametrize(
    "command",
    ["power on", "power off", "brake release", "play", "stop", "pause", "load a.urp", "shutdown"],
)
def test_local_control_refuses_what_moves_or_changes_the_robot(local, command):
    with DashboardClient(local.host) as dashboard:
        assert dashboard.ask(command) == (
            "Command is not allowed due to safety reasons, please switch robot to Remote Control "
            "mode and reconnect to port 29999"
        )


def test_local_control_answers_questions(local):
    with DashboardClient(local.host) as dashboard:
        assert dashboard.ask("is in remote control") == "false"
        assert dashboard.ask("robotmode") == "Robotmode: RUNNING"
        assert dashboard.ask("quit") == "Disconnected"


@pytest.fixture(scope="module")
def local():
    with SIM.spawn(remote=False) as running:
        yield running


def test_cb3_knows_its_own_commands_only():
    with SIM.spawn(model="ur10", version="3.5") as sim, DashboardClient(sim.host) as dashboard:
        assert dashboard.ask("PolyscopeVersion").startswith("URSoftware 3.5.0.0")
        for unknown in (
            "is in remote control",
            "get serial number",
            "safetystatus",
            "version",
            "set operational mode manual",
        ):
            assert dashboard.ask(unknown) == f"could not understand: '{unknown}'"
        assert dashboard.ask("getUserRole") == "PROGRAMMER"
        assert dashboard.ask("setUserRole operator") == "Setting user role: operator"


@pytest.mark.parametrize("role", ["OPERATOR", "NONE", "LOCKED", "RESTRICTED", "PROGRAMMER"])
def test_the_user_role_of_cb3_is_kept(cb3, role):
    with DashboardClient(cb3.host) as dashboard:
        assert dashboard.ask(f"setUserRole {role}") == f"Setting user role: {role}"
        assert dashboard.ask("getUserRole") == role
        assert dashboard.ask("setUserRole king") == "Failed setting user role: king"
        assert dashboard.ask("getUserRole") == role


@pytest.fixture(scope="module")
def cb3():
    with SIM.spawn(model="ur10", version="3.15.8") as running:
        yield running


def test_manual_mode_refuses_what_needs_remote_control_until_it_ends():
    with SIM.spawn() as sim, DashboardClient(sim.host) as dashboard:
        assert dashboard.ask("set operational mode manual") == "Operational mode MANUAL is set"
        assert dashboard.ask("get operational mode") == "MANUAL"
        assert dashboard.ask("is in remote control") == "false"
        assert dashboard.ask("power off").startswith("Command is not allowed")
        assert dashboard.ask("popup here").startswith("showing")
        sim.control.inject("enabling_device_released")
        eventually(
            lambda: (
                dashboard.ask("safetystatus") == "Safetystatus: SYSTEM_THREE_POSITION_ENABLING_STOP"
            )
        )
        assert dashboard.ask("safetymode") == "Safetymode: SAFEGUARD_STOP"
        assert dashboard.ask("clear operational mode") == (
            "No longer controlling the operational mode. Current operational mode: 'MANUAL'."
        )
        # The robot stays in the mode in which it is (tests of UR's client library).
        assert dashboard.ask("get operational mode") == "NONE"
        assert dashboard.ask("is in remote control") == "false"
        assert dashboard.ask("safetystatus") == "Safetystatus: SYSTEM_THREE_POSITION_ENABLING_STOP"
        assert (
            dashboard.ask("set operational mode automatic") == "Operational mode AUTOMATIC is set"
        )
        assert dashboard.ask("clear operational mode") == (
            "No longer controlling the operational mode. Current operational mode: 'AUTOMATIC'."
        )
        assert dashboard.ask("is in remote control") == "true"
        assert dashboard.ask("safetystatus") == "Safetystatus: NORMAL"
        assert dashboard.ask("power off") == "Powering off"


def test_programs_come_from_a_folder(tmp_path):
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell/pick.urp").write_bytes(b"\x1f\x8bcompressed tree")
    (tmp_path / "cell/pick.script").write_text("def pick():\n  sleep(100)\nend\n")
    (tmp_path / "tree.urp").write_bytes(b"\x1f\x8bcompressed tree")
    (tmp_path / "broken.script").write_text("nothing_such()\n")
    (tmp_path / "lines.script").write_text("sleep(100)\n")
    (tmp_path / "cell.installation").write_text("")
    (tmp_path.parent / "outside.script").write_text("sleep(1)\n")
    with SIM.spawn(programs=str(tmp_path)) as sim, DashboardClient(sim.host) as dashboard:
        assert dashboard.ask("load tree.urp") == "Error while loading program: tree.urp"
        assert dashboard.ask("load broken.script") == "Error while loading program: broken.script"
        assert dashboard.ask("load ../outside.script") == "File not found: ../outside.script"
        assert dashboard.ask("get loaded program") == "No program loaded"
        assert dashboard.ask("load lines.script") == "Loading program: /programs/lines.script"
        assert dashboard.ask("play") == "Starting program"
        assert dashboard.ask("load cell/pick.urp") == "Error while loading program: cell/pick.urp"
        assert dashboard.ask("stop") == "Stopped"
        assert dashboard.ask("load /ursim/programs/cell/pick.urp").endswith("/cell/pick.urp")
        assert dashboard.ask("get loaded program") == "Loaded program: /programs/cell/pick.urp"
        assert dashboard.ask("isProgramSaved") == "true pick.urp"
        assert dashboard.ask("load installation cell.installation").startswith("Loading")
        with PrimaryClient(sim.host) as primary:
            assert dashboard.ask("play") == "Starting program"
            eventually(lambda: primary.message(7)[9:] == b"PROGRAM_XXX_STARTEDpick")
        assert dashboard.ask("programState") == "PLAYING pick.urp"
        assert dashboard.ask("load installation cell.installation").startswith("Failed to load")


def test_a_folder_of_programs_that_is_not_there_is_refused():
    with pytest.raises(ConfigError, match="no folder"):
        SIM.spawn(programs="/nowhere")


def test_polyscope_x_has_no_dashboard():
    with SIM.spawn(version="10.9") as sim:
        assert "dashboard" not in sim.ports
        with pytest.raises(ConnectionRefusedError):
            DashboardClient(sim.host)
        PrimaryClient(sim.host).close()


def test_shutdown_ends_the_simulator():
    with SIM.spawn() as sim, DashboardClient(sim.host) as dashboard:
        assert dashboard.ask("shutdown") == "Shutting down"
        eventually(lambda: not sim.running)
        assert sim.stop() == 0


def test_endless_lines_do_no_harm(dashboard):
    for _ in range(50):
        dashboard.send(b"x" * 10_000)
    dashboard.send(b"\nrobotmode\n")
    assert dashboard.line().startswith("could not understand")
    assert dashboard.line() == "Robotmode: RUNNING"
