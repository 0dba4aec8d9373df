"""The unmodified ur_rtde library drives the simulated controller, with the script it uploads."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_rtde_runs import assert_all, run_session

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("rtde_control") is None, reason="needs ur-rtde"),
]

SESSIONS = Path(__file__).parents[3] / "rigs" / "ur_rtde_sessions.py"


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(lock_seconds=0.5) as running:
        yield running


def session(sim, name):
    return run_session(SESSIONS, sim, name, timeout=45)


def test_moves_and_kinematics(sim):
    limits = {"moveL_error": 1e-3, "FK_error": 1e-3, "IK_error": 1e-3}
    assert_all(session(sim, "moves"), **limits)


def test_servo_speed_and_jog(sim):
    assert_all(session(sim, "streams"), servoJ_error=5e-3)


def test_payload_tool_and_outputs(sim):
    assert_all(session(sim, "settings"), tcp=1e-9)


def test_the_watchdog_stops_the_program(sim):
    result = session(sim, "watchdog")
    assert 0.15 < result.pop("after") < 0.6  # s of controller time, at 4 Hz
    assert_all(result)


def test_protective_stop_unlock_and_new_upload(sim):
    result = session(sim, "protective_stop")
    assert result.pop("unlocked_at_once") is False
    assert_all(result)


@pytest.mark.sweep(4)
@pytest.mark.parametrize(
    ("model", "version"),
    [
        ("ur5", "3.15"),
        ("ur5e", "5.12"),
        ("ur10e", "5.23"),
        ("ur20", "10.11"),
    ],
)
def test_every_generation_of_software_is_driven(model, version):
    with SIM.spawn(model=model, version=version) as own:
        assert_all(session(own, "short"))


def test_ur_rtde_uploads_nothing_to_polyscope_x_before_10_11():
    """It constructs, but no program runs: such software is driven through the script ports."""
    with SIM.spawn(version="10.9") as own:
        assert session(own, "constructs") == {"connected": True, "playing": False}
        assert own.control.status()["scripts"] == []
