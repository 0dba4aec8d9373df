"""Defects of a simulated UR are what the driver measures; joints beside them are sound."""

from typing import Any

import numpy as np
import pytest

import crtk_drivers
from rigs.ur_bench import HOME, LONG, PATIENT

DEFECTS = (
    "position_noise=0.01,calibration=0.02,joints=1",
    "effort_sign=-1,joints=2",
    "position_line=0.02,line_frequency=40,joints=4",
    "position_drift=0.05,joints=6",
)


Measured = tuple[list[Any], list[Any], Any]
"""Joint states and poses of an arm that stands, and its kinematics."""


def measured(defects: str, count: int = 100) -> Measured:
    """Return what an arm with such defects tells in so many samples."""
    options = {"defects": defects, "version": "5.25.0"}
    with crtk_drivers.connect("ur", sim=True, sim_options=options, timeout=LONG, **PATIENT) as arm:
        states, poses = [], []
        for _ in range(count):
            before = arm.health().samples
            assert arm.engine.wait_for(lambda n=before: arm.health().samples > n, LONG)
            states.append(arm.measured_js())
            poses.append(arm.measured_cp())
        return states, poses, arm.engine.device.kinematics


@pytest.fixture(scope="module")
def without() -> Measured:
    return measured("")


def test_what_is_told_of_joints_and_tool_is_off(without: Measured) -> None:
    sound, sound_poses, kinematics = without
    states, poses, _ = measured(";".join(DEFECTS))
    assert np.std([state.position for state in sound], axis=0).max() < 1e-9
    spread = np.std([state.position for state in states], axis=0)
    assert spread[0] == pytest.approx(0.01, rel=0.5)
    assert spread[3] == pytest.approx(0.02 / np.sqrt(2.0), rel=0.5)
    assert spread[[1, 2, 4]].max() < 1e-9
    assert states[-1].position[5] - HOME[5] > 0.005
    assert states[0].effort[1] == pytest.approx(-sound[0].effort[1], rel=0.05)
    assert states[0].effort[2] == pytest.approx(sound[0].effort[2], rel=0.05)

    def error(state: Any, pose: Any) -> float:
        return float(np.abs(kinematics.forward(state.position).position - pose.position).max())

    at_rest = kinematics.forward(sound[0].position).position
    assert error(sound[0], sound_poses[0]) < 1e-4
    mean = np.mean([pose.position for pose in poses], axis=0)
    assert np.abs(mean - at_rest).max() > 5e-3, "the tool is told as if the base were turned"


def test_a_tool_is_told_in_millimetres(without: Measured) -> None:
    _, sound, _ = without
    _, poses, _ = measured("pose_scale=1000", 1)
    assert poses[0].position == pytest.approx(1000.0 * sound[0].position, rel=1e-3)
