"""A tracker and a marker on an arm against synthetic truth: exact, with noise, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.errors import CalibrationError
from crtk_drivers.labs.calibration import hand_eye
from crtk_drivers.labs.calibration.hand_eye import Method
from crtk_drivers.labs.calibration.stillness import distance
from crtk_drivers.samples import Pose
from rigs.measured_poses import arm_and_marker, pose

MARKER, TRACKER = (
    pose((0.02, -0.05, 0.11), (0.5, 1.2, -0.7)),
    pose((1.4, 0.3, 0.8), (-1.0, 2.0, 0.4)),
)
METHODS: tuple[Method, ...] = ("park", "tsai")
triples = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


def near(first: Pose, second: Pose, metres: float, rad: float) -> bool:
    far, turned = distance(first, second)
    return far < metres and turned < rad


@given(position=triples, x=triples, y=triples)
@pytest.mark.parametrize("method", METHODS)
def test_without_noise_both_are_exact(
    method: Method, position: tuple[float, ...], x: tuple[float, ...], y: tuple[float, ...]
) -> None:
    marker, tracker = pose(position, x), pose(position, y)
    found = hand_eye(*arm_and_marker(marker, tracker, 8, np.random.default_rng(5)), method)
    assert near(found.marker, marker, 1e-7, 1e-7)
    assert near(found.tracker, tracker, 1e-7, 1e-7)
    assert found.residual < 1e-7


@pytest.mark.parametrize("method", METHODS)
def test_a_marker_that_is_turned_by_half_a_turn_is_found(method: Method) -> None:
    marker = pose((0.0, 0.0, 0.1), (np.pi, 0.0, 0.0))
    found = hand_eye(*arm_and_marker(marker, TRACKER, 8, np.random.default_rng(6)), method)
    assert near(found.marker, marker, 1e-7, 1e-7)


@pytest.mark.parametrize("method", METHODS)
def test_with_noise_it_is_as_near_as_the_noise_lets_it(method: Method) -> None:
    noise, far = np.random.default_rng(7), []
    for _ in range(20):
        pairs = arm_and_marker(MARKER, TRACKER, 15, noise, 0.25e-3, 1e-3)
        found = hand_eye(*pairs, method)
        far.append(distance(found.marker, MARKER))
        assert 0.2e-3 < found.residual < 3e-3
    off, turned = np.sqrt(np.mean(np.square(far), axis=0))
    assert off < 1e-3
    assert turned < 1.5e-3


def test_an_arm_that_turned_about_one_axis_or_not_at_all_is_refused() -> None:
    noise = np.random.default_rng(8)
    for rotvecs in ([(0.0, 0.0, 0.3 * n) for n in range(8)], [(0.1, 0.2, 0.3)] * 8):
        arm = [pose(noise.uniform(-0.5, 0.5, 3).tolist(), each) for each in rotvecs]
        with pytest.raises(CalibrationError, match="hardly turned, or about one axis"):
            hand_eye(arm, arm)


def test_a_marker_that_is_not_on_the_arm_is_refused() -> None:
    noise = np.random.default_rng(9)
    arm, _ = arm_and_marker(MARKER, TRACKER, 12, noise)
    _, other = arm_and_marker(MARKER, TRACKER, 12, noise)
    with pytest.raises(CalibrationError, match="did not turn alike"):
        hand_eye(arm, other)


def test_a_pair_that_was_taken_in_motion_is_named() -> None:
    arm, seen = arm_and_marker(MARKER, TRACKER, 12, np.random.default_rng(10))
    seen[7] = Pose(seen[7].position + 0.2, seen[7].orientation)
    with pytest.raises(CalibrationError, match=r"residual .* at pair 8"):
        hand_eye(arm, seen)


def test_too_few_and_unequal_pairs_are_refused() -> None:
    arm, seen = arm_and_marker(MARKER, TRACKER, 6, np.random.default_rng(11))
    with pytest.raises(CalibrationError, match="6 poses of the arm and 5 of the marker"):
        hand_eye(arm, seen[:5])
    with pytest.raises(CalibrationError, match="4 poses are too few"):
        hand_eye(arm[:4], seen[:4])
