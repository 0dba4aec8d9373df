"""The tip of a pointer against synthetic truth: exact, with noise, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.errors import CalibrationError
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.labs.calibration import pivot
from crtk_drivers.samples import Pose, vector
from rigs.measured_poses import about_its_tip

TIP, PLACE = (0.018, -0.003, -0.157), (0.1, -0.2, -1.3)


@given(
    tip=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    place=st.tuples(*[st.floats(-2.0, 2.0)] * 3),
    seed=st.integers(0, 1000),
)
def test_without_noise_the_tip_is_exact(
    tip: tuple[float, ...], place: tuple[float, ...], seed: int
) -> None:
    found = pivot(about_its_tip(tip, place, 30, 0.5, np.random.default_rng(seed)))
    assert np.allclose(found.tip, tip, atol=1e-9)
    assert np.allclose(found.place, place, atol=1e-9)
    assert found.residual < 1e-9


def test_with_noise_the_deviation_that_is_told_is_that_of_many_trials() -> None:
    noise = np.random.default_rng(3)
    trials = [pivot(about_its_tip(TIP, PLACE, 100, 0.5, noise, 0.25e-3)) for _ in range(150)]
    scatter = np.std([each.tip for each in trials], axis=0)
    told = np.mean([each.deviation for each in trials], axis=0)
    assert np.allclose(told, scatter, rtol=0.2)
    assert np.allclose(np.mean([each.tip for each in trials], axis=0), TIP, atol=0.1e-3)
    residual = np.mean([each.residual for each in trials])
    assert residual == pytest.approx(0.25e-3 * np.sqrt(3), rel=0.05)


def test_a_pointer_that_hardly_turned_or_about_one_axis_only_is_refused() -> None:
    noise = np.random.default_rng(1)
    with pytest.raises(CalibrationError, match="hardly turned"):
        pivot(about_its_tip(TIP, PLACE, 50, 0.03, noise))
    spun = [
        Pose(vector(np.array(PLACE)), quaternion_from_rotvec(vector((0.0, 0.0, angle))))
        for angle in np.linspace(-3.0, 3.0, 50)
    ]
    with pytest.raises(CalibrationError, match="one axis only"):
        pivot(spun)


def test_a_tip_that_slipped_is_refused_and_the_worst_pose_named() -> None:
    poses = about_its_tip(TIP, PLACE, 40, 0.5, np.random.default_rng(2))
    poses[16] = Pose(vector(poses[16].position + 0.03), poses[16].orientation)
    with pytest.raises(CalibrationError, match=r"did not rest.* at pose 17"):
        pivot(poses)
    assert pivot(poses, worst=0.05).residuals.argmax() == 16


def test_too_few_poses_and_those_that_are_none_are_refused() -> None:
    poses = about_its_tip(TIP, PLACE, 30, 0.5, np.random.default_rng(2))
    with pytest.raises(CalibrationError, match="19 poses are too few"):
        pivot(poses[:19])
    poses[4] = Pose(vector((np.nan, 0.0, 0.0)), poses[4].orientation)
    with pytest.raises(CalibrationError, match="number 5 of the poses"):
        pivot(poses)
    poses[4] = Pose(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 0.5)))
    with pytest.raises(CalibrationError, match="number 5 of the poses"):
        pivot(poses)
