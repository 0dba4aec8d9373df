"""Registration by points against synthetic truth: exact, with noise, mirrored, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.errors import CalibrationError
from crtk_drivers.geometry.conversions import to_matrix
from crtk_drivers.labs.calibration import register
from crtk_drivers.samples import Array, Pose
from rigs.measured_poses import pose

MODEL = np.array(
    [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.1, 0.08, 0.0), (0.0, 0.08, 0.02), (0.05, 0.04, 0.06)]
)
PLACE = pose((0.3, -0.1, -1.1), (0.4, -2.0, 0.7))


def seen(model: Array, place: Pose) -> Array:
    matrix = to_matrix(place)
    found: Array = model @ matrix[:3, :3].T + matrix[:3, 3]
    return found


def same(found: Pose, place: Pose) -> bool:
    return np.allclose(to_matrix(found), to_matrix(place), atol=1e-8)


triples = st.tuples(*[st.floats(-2.5, 2.5)] * 3)


@given(position=triples, rotvec=triples)
@pytest.mark.parametrize("count", [3, 4, 5], ids=["three", "a plane", "a body"])
def test_without_noise_the_place_is_exact(
    position: tuple[float, ...], rotvec: tuple[float, ...], count: int
) -> None:
    model, place = MODEL[:count], pose(position, rotvec)
    found = register(model, seen(model, place))
    assert same(found.pose, place)
    assert found.fre < 1e-9
    assert not found.mirrored


def test_points_that_are_mirrored_give_a_rotation_and_are_told() -> None:
    mirrored = seen(MODEL * (1.0, 1.0, -1.0), PLACE)
    found = register(MODEL, mirrored)
    assert found.mirrored
    assert np.linalg.det(to_matrix(found.pose)[:3, :3]) == pytest.approx(1.0)
    with pytest.raises(CalibrationError, match="mirror images"):
        register(MODEL, mirrored, worst=1e-3)


def test_with_noise_the_errors_that_are_told_are_those_of_many_trials() -> None:
    noise, fle, target = np.random.default_rng(4), 0.3e-3, np.array([(0.05, 0.2, 0.1)])
    there = seen(target, PLACE)
    trials = []
    for _ in range(400):
        measured = seen(MODEL, PLACE) + fle / np.sqrt(3) * noise.standard_normal(MODEL.shape)
        found = register(MODEL, measured)
        off = np.linalg.norm(seen(target, found.pose) - there)
        trials.append((off, found.tre(target[0]), found.fle))
    off, told, located = np.sqrt(np.mean(np.square(trials), axis=0))
    assert located == pytest.approx(fle, rel=0.05)
    assert told == pytest.approx(off, rel=0.1)


def test_points_on_a_line_and_too_few_and_unequal_ones_are_refused() -> None:
    line = np.outer(np.arange(5.0), (0.1, 0.02, 0.0))
    for model, measured in ((line, MODEL), (MODEL, line), (MODEL * 0.0, MODEL)):
        with pytest.raises(CalibrationError, match="one line"):
            register(model, measured)
    with pytest.raises(CalibrationError, match="4 measured points for 5"):
        register(MODEL, MODEL[:4])
    with pytest.raises(CalibrationError, match="at least 3"):
        register(MODEL[:2], MODEL[:2])
    with pytest.raises(CalibrationError, match="not finite"):
        register(MODEL, MODEL * np.nan)


def test_a_wrong_point_is_named() -> None:
    measured = seen(MODEL, PLACE)
    measured[2] += (0.0, 0.03, 0.0)
    with pytest.raises(CalibrationError, match="at point 3"):
        register(MODEL, measured, worst=2e-3)
