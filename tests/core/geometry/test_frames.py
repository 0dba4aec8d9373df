"""The frames of sub-namespaces: increments, twists, wrenches, Jacobians."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crtk_drivers.geometry.frames import (
    both,
    inverse_pose,
    jacobian_from_base,
    moved,
    product,
    twist_from_base,
    twist_in_base,
    wrench_from_base,
    wrench_in_base,
)
from crtk_drivers.geometry.quaternions import matrix_from_quaternion, quaternion_from_rotvec
from crtk_drivers.geometry.rates import turn
from crtk_drivers.samples import Array, Pose, Vector, vector

FRAMES = st.sampled_from(["", "body", "spatial", "local"])

numbers = st.floats(-1.0, 1.0)
three = arrays(float, 3, elements=numbers).map(vector)
six = arrays(float, 6, elements=numbers).map(vector)
rotations = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(lambda r: quaternion_from_rotvec(vector(r)))
poses = st.builds(Pose, three, rotations)


def matrix(pose: Pose) -> Array:
    full = np.eye(4)
    full[:3, :3] = matrix_from_quaternion(pose.orientation)
    full[:3, 3] = pose.position
    return full


def test_known_increments() -> None:
    quarter = quaternion_from_rotvec(vector((0.0, 0.0, math.pi / 2)))
    here = Pose(vector((1.0, 0.0, 0.0)), quarter, "base")
    step = Pose(vector((0.1, 0.0, 0.0)), quaternion_from_rotvec(vector((0.2, 0.0, 0.0))))
    known = {
        "": ((1.1, 0.0, 0.0), (0.2, 0.0, 0.0)),
        "body": ((1.0, 0.1, 0.0), (0.0, 0.2, 0.0)),
        "spatial": ((1.1, 0.0, 0.0), (0.2, 0.0, 0.0)),
    }
    for frame, (position, spun) in known.items():
        after = moved(here, step, frame)
        assert after.position == pytest.approx(position), frame
        assert turn(after.orientation, quarter) == pytest.approx(spun), frame
        assert after.frame_id == "base"
    down = Pose(vector((5.0, 0.0, 0.0)), quaternion_from_rotvec(vector((0.0, math.pi, 0.0))))
    after = moved(here, step, "local", down)
    assert after.position == pytest.approx([0.9, 0.0, 0.0])
    assert turn(after.orientation, quarter) == pytest.approx([-0.2, 0.0, 0.0])


@given(poses, poses)
def test_increments_are_these_products(here: Pose, step: Pose) -> None:
    t, d = matrix(here), matrix(step)
    assert matrix(moved(here, step, "body")) == pytest.approx(t @ d, abs=1e-9)
    assert matrix(moved(here, step, "spatial")) == pytest.approx(d @ t, abs=1e-9)
    base = matrix(moved(here, step))
    assert base[:3, 3] == pytest.approx(t[:3, 3] + d[:3, 3], abs=1e-9)
    assert base[:3, :3] == pytest.approx(d[:3, :3] @ t[:3, :3], abs=1e-9)


@given(poses, six, FRAMES, poses)
def test_a_twist_is_the_increment_of_a_short_time(
    here: Pose, twist: Vector, frame: str, base: Pose
) -> None:
    dt = 1e-6
    step = Pose(vector(twist[:3] * dt), quaternion_from_rotvec(vector(twist[3:] * dt)))
    after = moved(here, step, frame, base)
    in_base = twist_in_base(twist, frame, here, base)
    assert (after.position - here.position) / dt == pytest.approx(in_base[:3], abs=1e-5)
    assert turn(after.orientation, here.orientation) / dt == pytest.approx(in_base[3:], abs=1e-5)


@given(poses, six, FRAMES, poses)
def test_there_and_back(here: Pose, values: Vector, frame: str, base: Pose) -> None:
    twist = twist_from_base(twist_in_base(values, frame, here, base), frame, here, base)
    assert twist == pytest.approx(values, abs=1e-9)
    wrench = wrench_from_base(wrench_in_base(values, frame, here, base), frame, here, base)
    assert wrench == pytest.approx(values, abs=1e-9)


@given(poses, six, six, FRAMES, poses)
def test_power_is_the_same_in_every_frame(
    here: Pose, twist: Vector, wrench: Vector, frame: str, base: Pose
) -> None:
    there = twist_from_base(twist, frame, here, base) @ wrench_from_base(wrench, frame, here, base)
    assert there == pytest.approx(twist @ wrench, abs=1e-9)


def test_known_wrench() -> None:
    quarter = quaternion_from_rotvec(vector((0.0, 0.0, math.pi / 2)))
    here = Pose(vector((1.0, 0.0, 0.0)), quarter)
    push = vector((0.0, 2.0, 0.0, 0.0, 0.0, 0.5))
    assert wrench_from_base(push, "body", here) == pytest.approx([2.0, 0.0, 0.0, 0.0, 0.0, 0.5])
    assert wrench_from_base(push, "spatial", here) == pytest.approx([0.0, 2.0, 0.0, 0.0, 0.0, 2.5])


@given(poses, poses, poses, st.sampled_from(["", "body", "spatial"]))
def test_two_increments_are_one(here: Pose, first: Pose, second: Pose, frame: str) -> None:
    step_by_step = moved(moved(here, first, frame), second, frame)
    at_once = moved(here, both(first, second, frame), frame)
    assert matrix(at_once) == pytest.approx(matrix(step_by_step), abs=1e-9)


@given(arrays(float, (6, 4), elements=numbers), arrays(float, 4, elements=numbers), poses, FRAMES)
def test_a_jacobian_gives_the_twist_of_its_frame(
    jacobian: Array, rates: Array, here: Pose, frame: str
) -> None:
    expected = twist_from_base(vector(jacobian @ rates), frame, here)
    found = jacobian_from_base(jacobian, frame, here) @ rates
    assert found == pytest.approx(expected, abs=1e-9)


@given(poses, poses)
def test_products_and_inverses_are_those_of_matrices(first: Pose, second: Pose) -> None:
    assert matrix(product(first, second)) == pytest.approx(matrix(first) @ matrix(second), abs=1e-9)
    assert matrix(inverse_pose(first)) == pytest.approx(np.linalg.inv(matrix(first)), abs=1e-9)
