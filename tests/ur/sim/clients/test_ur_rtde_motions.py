"""Blends, contact, freedrive and dynamics through the unmodified ur_rtde library."""

from importlib.util import find_spec
from pathlib import Path

import pytest

from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.motion.dynamics import Dynamics
from crtk_sim_backends.ur.motion.kinematics import Kinematics
from rigs.ur_rtde_runs import assert_all, run_session

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("rtde_control") is None, reason="needs ur-rtde"),
]

SESSIONS = Path(__file__).parents[3] / "rigs" / "ur_rtde_motions.py"


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(version="5.23") as running:
        yield running


def session(sim, name):
    return run_session(SESSIONS, sim, name, timeout=90)


def test_paths_with_blends_and_their_progress(sim):
    result = session(sim, "paths")
    progress = result.pop("progress")
    assert progress == sorted(progress)
    assert progress[-1] >= 2
    assert_all(result, blended_error=1e-3, async_error=1e-3)


def test_force_mode_and_contact_detection_on_a_surface(sim):
    assert_all(session(sim, "contact"), at_table=2e-3, stopped_at_table=2e-3)


def test_freedrive_along_one_axis(sim):
    assert_all(session(sim, "freedrive"), across=1e-3)


def test_mass_matrix_jacobian_and_coriolis_torques(sim):
    result = session(sim, "dynamics")
    kinematics = Kinematics(MODELS["ur5e"])
    q = result["q"]
    mass = Dynamics(kinematics).mass_matrix(q, 0.0, (0.0, 0.0, 0.0))
    jacobian = kinematics.jacobian(q)
    for name, matrix in (("mass", mass), ("jacobian", jacobian)):
        flat = [matrix[row][column] for column in range(6) for row in range(6)]
        assert result[name] == pytest.approx(flat, abs=1e-4), name
    assert result["coriolis"] == pytest.approx([0.0] * 6, abs=1e-6)


def test_torque_control():
    """Which the library does with software from 10.11 on."""
    with SIM.spawn(version="10.11") as own:
        assert_all(session(own, "torque"))
