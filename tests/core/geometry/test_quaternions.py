"""Rotations: known answers, and properties that hold for all of them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.geometry.quaternions import (
    matrix_from_quaternion,
    pose_from_rotvec,
    quaternion_from_matrix,
    quaternion_from_rotvec,
    quaternion_product,
    rotvec_from_pose,
    rotvec_from_quaternion,
)
from crtk_drivers.samples import Vector, vector

HALF = math.sqrt(0.5)
component = st.floats(-1.0, 1.0)
unit = (
    st.tuples(component, component, component, component)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: vector(np.array(q) / np.linalg.norm(q)))
)
rotvec = st.tuples(*[st.floats(-1.8, 1.8)] * 3).map(vector)  # of a norm below pi
tiny = st.tuples(*[st.floats(-1e-4, 1e-4)] * 3).map(vector)


def same_rotation(a: Vector, b: Vector) -> bool:
    return abs(abs(float(np.dot(a, b))) - 1.0) < 1e-12


@pytest.mark.parametrize(
    ("vector_", "quaternion"),
    [
        ((0, 0, 0), (0, 0, 0, 1)),
        ((math.pi / 2, 0, 0), (HALF, 0, 0, HALF)),
        ((0, math.pi, 0), (0, 1, 0, 0)),
        ((0, 0, -math.pi / 2), (0, 0, -HALF, HALF)),
    ],
)
def test_known_rotations(vector_: tuple[float, ...], quaternion: tuple[float, ...]) -> None:
    assert quaternion_from_rotvec(vector(vector_)) == pytest.approx(quaternion, abs=1e-15)
    assert rotvec_from_quaternion(vector(quaternion)) == pytest.approx(vector_, abs=1e-15)


def test_a_quarter_turn_about_z_takes_x_to_y() -> None:
    matrix = matrix_from_quaternion(vector((0, 0, HALF, HALF)))
    assert matrix @ [1, 0, 0] == pytest.approx([0, 1, 0], abs=1e-15)


@given(rotvec | tiny)
def test_rotation_vectors_survive_the_way_there_and_back(r: Vector) -> None:
    q = quaternion_from_rotvec(r)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)
    assert rotvec_from_quaternion(q) == pytest.approx(r, abs=1e-13, rel=1e-9)


@given(unit)
def test_quaternions_survive_the_way_over_matrices_and_rotation_vectors(q: Vector) -> None:
    matrix = matrix_from_quaternion(q)
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    assert same_rotation(quaternion_from_matrix(matrix), q)
    r = rotvec_from_quaternion(q)
    assert np.linalg.norm(r) <= math.pi + 1e-12
    assert same_rotation(quaternion_from_rotvec(r), q)


@given(unit, unit)
def test_the_product_turns_by_the_right_one_first(a: Vector, b: Vector) -> None:
    product = matrix_from_quaternion(quaternion_product(a, b))
    assert product == pytest.approx(
        matrix_from_quaternion(a) @ matrix_from_quaternion(b), abs=1e-12
    )


@given(st.tuples(*[st.floats(-2.0, 2.0)] * 3), rotvec)
def test_poses_survive_the_way_there_and_back(position: tuple[float, ...], r: Vector) -> None:
    six = vector((*position, *r))
    pose = pose_from_rotvec(six, "base")
    assert pose.frame_id == "base"
    assert rotvec_from_pose(pose) == pytest.approx(six, abs=1e-12)
