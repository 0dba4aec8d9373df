"""Values as they travel between MATLAB and Python."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crtk_drivers.client.matlab.wire import arguments_of, decoded, encoded, parts_of, pose
from crtk_drivers.commands import COMMANDS
from crtk_drivers.errors import CommandRefused
from crtk_drivers.geometry.conversions import to_matrix
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.samples import (
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    Matrix,
    Number,
    Pose,
    Twist,
    Wrench,
    vector,
)

SHAPES = st.tuples(st.integers(0, 7), st.integers(0, 7))
IDENTITY = np.eye(4)


@given(arrays(np.float64, SHAPES))
def test_an_array_arrives_to_the_last_digit(array: Any) -> None:
    found = decoded(json.loads(json.dumps(encoded(array))))
    expected = array.ravel() if min(array.shape) <= 1 else array
    assert found.shape == expected.shape
    assert np.array_equal(found, expected, equal_nan=True)


def test_known_answers() -> None:
    assert encoded(np.array([[1.0, 2.5], [np.nan, -np.inf]])) == {
        "size": [2, 2],
        "data": "1.0,NaN,2.5,-Inf,",
    }
    assert encoded(np.array([0.1, np.inf])) == {"size": [2, 1], "data": "0.1,Inf,"}
    found = decoded({"size": [2, 3], "data": "1,2,3,4,NaN,-Inf,"})  # as sprintf('%.17g,') writes it
    assert np.array_equal(found, [[1.0, 3.0, np.nan], [2.0, 4.0, -np.inf]], equal_nan=True)


@given(
    arrays(np.float64, 3, elements=st.floats(-4.0, 4.0)),
    st.sampled_from([None, 0.0, 1e-9, 3.0, np.pi - 1e-9, np.pi]),
)
def test_a_pose_there_and_back(rotvec: Any, angle: float | None) -> None:
    length = float(np.linalg.norm(rotvec))
    if angle is not None and length > 1e-3:
        rotvec = rotvec * (angle / length)
    quaternion = quaternion_from_rotvec(vector(rotvec))
    there = Pose(vector((0.1, -0.2, 0.3)), quaternion)
    (matrix,) = parts_of(there)
    assert np.allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-12)
    back = pose(decoded(encoded(matrix)))
    assert np.array_equal(back.position, there.position)
    assert abs(float(back.orientation @ quaternion)) == pytest.approx(1.0, abs=1e-12)
    assert np.allclose(to_matrix(back), matrix, atol=1e-12)
    seven = pose(np.concatenate((there.position, quaternion)))
    assert np.allclose(to_matrix(seven), matrix, atol=1e-12)


def test_parts_have_the_shapes_of_matlab() -> None:
    six, three = np.arange(6.0), np.arange(3.0)
    shapes = {
        JointState(three, three, three): [(3, 1)] * 3,
        JointState(three): [(3, 1), (0, 1), (0, 1)],
        Pose(three, vector((0.0, 0.0, 0.0, 1.0))): [(4, 4)],
        Twist(six[:3], six[3:]): [(1, 6)],
        Wrench(six[:3], six[3:]): [(1, 6)],
        Matrix(np.zeros((6, 1))): [(6, 1)],
        Number(0.5): [(1, 1)],
    }
    for value, expected in shapes.items():
        assert [tuple(encoded(part)["size"]) for part in parts_of(value)] == expected


def value_of(name: str, *arguments: Any) -> Any:
    (value,) = arguments_of(COMMANDS[name], [np.asarray(a, dtype=float) for a in arguments], "/r")
    return value


def test_arguments_of_every_kind_of_command() -> None:
    assert value_of("servo_jp", [1, 2]).position.tolist() == [1.0, 2.0]
    assert value_of("servo_jv", [1, 2]).velocity.tolist() == [1.0, 2.0]
    assert value_of("servo_jf", [1, 2]).effort.tolist() == [1.0, 2.0]
    both = value_of("servo_jp", [1, 2], [3, 4])
    assert (both.position.tolist(), both.velocity.tolist()) == ([1.0, 2.0], [3.0, 4.0])
    assert isinstance(value_of("move_cp", IDENTITY), Pose)
    assert value_of("servo_cv", range(6)).angular.tolist() == [3.0, 4.0, 5.0]
    assert value_of("servo_cf", range(6)).torque.tolist() == [3.0, 4.0, 5.0]
    mixed = value_of("servo_js", [1, 2], [0.1, 0.0], [0.0, 0.2])
    assert isinstance(mixed, JointServo)
    assert (mixed.modes, mixed.velocity.tolist()) == ((1, 2), [0.0, 0.2])
    task = np.diag([1.0, -1.0, -1.0, 1.0])
    tool = value_of("servo_cs", [1, 1, 4, 1, 1, 1], IDENTITY, range(6), range(6, 12), task)
    assert isinstance(tool, CartesianServo)
    assert tool.modes == (1, 1, 4, 1, 1, 1)
    assert tool.wrench.force.tolist() == [6.0, 7.0, 8.0]
    assert tool.task.orientation.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert value_of("trajectory_j/set_ratio", [0.5]) == Number(0.5)
    assert value_of("use_gravity_compensation", [1]) == Flag(True)
    assert arguments_of(COMMANDS["hold"], [], "/r") == ()
    reached, near = arguments_of(COMMANDS["inverse_kinematics"], [task, np.arange(2.0)], "/r")
    assert isinstance(reached, Pose)
    assert isinstance(near, np.ndarray)
    assert near.tolist() == [0.0, 1.0]
    assert value_of("forward_kinematics", [1, 2]).tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("name", "arguments", "text"),
    [
        ("servo_jp", [[[1, 2], [3, 4]]], "one number for each joint"),
        ("servo_jp", [[1], [2], [3]], "3 arguments"),
        ("servo_jp", [[1, 2], [3]], "different sizes"),
        ("servo_jv", [[1], [2]], "2 arguments"),
        ("servo_cp", [np.zeros((4, 4))], "no rotation matrix"),
        ("servo_cp", [np.full((4, 4), np.nan)], "no rotation matrix"),
        ("servo_cp", [np.diag([1.0, 1.0, -1.0, 1.0])], "no rotation matrix"),
        ("servo_cp", [np.eye(3)], "4x4"),
        ("servo_cv", [range(5)], "6 numbers"),
        ("servo_js", [[1, 1.5], [0, 0]], "modes are whole numbers"),
        ("servo_js", [[1, 1], [0, 0, 0]], "2 modes"),
        ("servo_js", [[1, 1]], "1 arguments"),
        ("servo_cs", [[1] * 6, IDENTITY, range(5), range(6), IDENTITY], "6 numbers"),
        ("trajectory_j/set_ratio", [[0.5, 0.5]], "2 numbers"),
        ("use_gravity_compensation", [[2]], "true or false"),
        ("hold", [[1]], "Pass nothing"),
        ("forward_kinematics", [IDENTITY], "one number for each joint"),
        ("inverse_kinematics", [np.eye(3)], "a 4x4 pose"),
        ("inverse_kinematics", [], "0 arguments"),
    ],
)
def test_what_a_command_does_not_take_is_refused(
    name: str, arguments: list[Any], text: str
) -> None:
    with pytest.raises(CommandRefused, match=text) as refusal:
        value_of(name, *arguments)
    assert str(refusal.value).startswith(f"/r: {name} refused (wrong_type): ")
