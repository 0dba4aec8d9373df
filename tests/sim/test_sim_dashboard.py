"""The dashboard: replies, refusals in local control, and what older software does not know."""

import pytest
from ur_clients import DashboardClient, PrimaryClient, wait_until

from crtk_sim_backends.ur import SIM


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


def test_quit_closes_the_connection(dashboard):
    assert dashboard.ask("quit") == "Disconnected"
    assert dashboard.closed_by_peer()


def test_power_off_power_on_and_brake_release():
    with SIM.spawn(powered_on=False) as sim, DashboardClient(sim.host) as dashboard:
        assert dashboard.ask("robotmode") == "Robotmode: POWER_OFF"
        assert dashboard.ask("power on") == "Powering on"
        wait_until(lambda: dashboard.ask("robotmode") == "Robotmode: IDLE", 10)
        assert dashboard.ask("brake release") == "Brake releasing"
        wait_until(lambda: dashboard.ask("robotmode") == "Robotmode: RUNNING", 10)
        assert dashboard.ask("power off") == "Powering off"
        wait_until(lambda: dashboard.ask("robotmode") == "Robotmode: POWER_OFF", 10)


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
        wait_until(lambda: dashboard.ask("programState") == "PLAYING external_control.urp")
        assert dashboard.ask("running") == "Program running: true"
        assert dashboard.ask("pause") == "Pausing program"
        wait_until(lambda: dashboard.ask("programState") == "PAUSED external_control.urp")
        assert dashboard.ask("play") == "Starting program"
        wait_until(lambda: dashboard.ask("programState") == "PLAYING external_control.urp")
        assert dashboard.ask("stop") == "Stopped"
        wait_until(lambda: dashboard.ask("programState") == "STOPPED external_control.urp")


def test_a_protective_stop_cannot_be_unlocked_at_once(sim):
    with DashboardClient(sim.host) as dashboard:
        sim.control.inject("protective_stop")
        wait_until(lambda: dashboard.ask("safetystatus") == "Safetystatus: PROTECTIVE_STOP")
        assert dashboard.ask("unlock protective stop").startswith("Cannot unlock protective stop")
        answers = []
        wait_until(
            lambda: (
                answers.append(dashboard.ask("unlock protective stop"))
                or answers[-1] == "Protective stop releasing"
            ),
            10,
            pause=0.1,
        )
        wait_until(lambda: dashboard.ask("safetystatus") == "Safetystatus: NORMAL")


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


def test_polyscope_x_has_no_dashboard():
    with SIM.spawn(version="10.9") as sim:
        assert "dashboard" not in sim.ports
        with pytest.raises(ConnectionRefusedError):
            DashboardClient(sim.host)
        PrimaryClient(sim.host).close()


def test_shutdown_ends_the_simulator():
    with SIM.spawn() as sim, DashboardClient(sim.host) as dashboard:
        assert dashboard.ask("shutdown") == "Shutting down"
        wait_until(lambda: not sim.running)
        assert sim.stop() == 0


def test_endless_lines_do_no_harm(dashboard):
    for _ in range(50):
        dashboard.send(b"x" * 10_000)
    dashboard.send(b"\nrobotmode\n")
    assert dashboard.line().startswith("could not understand")
    assert dashboard.line() == "Robotmode: RUNNING"
