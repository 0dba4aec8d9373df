"""Values into messages, through the wire format, and back: no number may change on the way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped, WrenchStamped
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Float64MultiArray

from crtk_drivers.commands import Payload
from crtk_drivers.ros.messages import (
    TYPES,
    fill,
    fill_status,
    fill_transform,
    set_stamp,
    stamp_ns,
    value_of,
)
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
from crtk_drivers.state import OperatingState, Status

numbers = st.floats(allow_nan=False)
threes = st.tuples(numbers, numbers, numbers)
fours = st.tuples(numbers, numbers, numbers, numbers)


def over_the_wire(message: Any) -> Any:
    return deserialize_message(serialize_message(message), type(message))


@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=8))
def test_joint_state(rows: list[tuple[float, float, float]]) -> None:
    position, velocity, effort = (vector(column) for column in zip(*rows, strict=True))
    names = tuple(f"joint_{i}" for i in range(len(rows)))
    message = JointStateMessage(name=["old"], position=[9.0], effort=[9.0] * 9)
    fill(message, JointState(position, velocity, effort, names))
    back = value_of(over_the_wire(message), "")
    assert isinstance(back, JointState)
    assert back.name == names
    for sent, received in zip(
        (position, velocity, effort), (back.position, back.velocity, back.effort), strict=True
    ):
        np.testing.assert_array_equal(sent, received)


def test_what_is_not_known_is_empty_also_in_a_used_message() -> None:
    message = JointStateMessage(velocity=[1.0], effort=[1.0])
    fill(message, JointState(position=vector([1.0])))
    assert (len(message.velocity), len(message.effort), len(message.name)) == (0, 0, 0)


@given(threes, fours)
def test_pose(position: tuple[float, ...], orientation: tuple[float, ...]) -> None:
    message = PoseStamped()
    fill(message, Pose(vector(position), vector(orientation)))
    back = value_of(over_the_wire(message), "base")
    assert isinstance(back, Pose)
    assert (tuple(back.position), tuple(back.orientation)) == (position, orientation)
    assert back.frame_id == "base"


@given(threes, threes)
def test_twist_and_wrench_are_linear_first(first: Any, second: Any) -> None:
    twist, wrench = TwistStamped(), WrenchStamped()
    fill(twist, Twist(vector(first), vector(second)))
    fill(wrench, Wrench(vector(first), vector(second)))
    twist, wrench = over_the_wire(twist), over_the_wire(wrench)
    assert (twist.twist.linear.x, twist.twist.angular.z) == (first[0], second[2])
    assert (wrench.wrench.force.y, wrench.wrench.torque.x) == (first[1], second[0])
    for message in (twist, wrench):
        back = value_of(message, "")
        assert isinstance(back, Twist | Wrench)
        np.testing.assert_array_equal(back.vector, (*first, *second))


@pytest.mark.parametrize("kind", [np.int64, np.float32, np.int8, np.bool_])
def test_numpy_kinds_are_not_corrupted(kind: Any) -> None:
    """Unconverted, an int 1 in a float64 field is published as 5e-324."""
    ones = np.ones(4, dtype=kind)
    pose = PoseStamped()
    fill(pose, Pose(ones[:3], ones))
    back = over_the_wire(pose).pose
    assert (back.position.x, back.orientation.w) == (1.0, 1.0)
    joints = JointStateMessage()
    fill(joints, JointState(ones))
    assert list(over_the_wire(joints).position) == [1.0] * 4


def test_status_with_numpy_flags_is_not_corrupted() -> None:
    message = TYPES[Payload.OPERATING_STATE]()
    status = Status(OperatingState.ENABLED, np.bool_(True), np.bool_(True))  # type: ignore[arg-type]
    fill_status(message, status, 1)
    back = over_the_wire(message)
    assert (back.state, back.is_homed, back.is_busy) == ("ENABLED", True, True)


def test_matrix_and_transform() -> None:
    matrix = Float64MultiArray()
    fill(matrix, Matrix(np.arange(12.0).reshape(2, 6)))
    back = over_the_wire(matrix)
    assert [d.size for d in back.layout.dim] == [2, 6]
    assert list(back.data) == list(range(12))
    transform = TransformStamped()
    fill_transform(transform, Pose(vector([1, 2, 3]), vector([0, 0, 0, 1])))
    back = over_the_wire(transform).transform
    assert (back.translation.z, back.rotation.w) == (3.0, 1.0)


@given(st.integers(min_value=0, max_value=2**31 * 10**9 - 1))
def test_stamps(nanoseconds: int) -> None:
    message = PoseStamped()
    set_stamp(message.header.stamp, nanoseconds)
    assert stamp_ns(over_the_wire(message).header.stamp) == nanoseconds


def test_vectors_of_unlike_size_are_an_error() -> None:
    with pytest.raises(ValueError, match="different sizes"):
        value_of(JointStateMessage(position=[1.0], velocity=[1.0, 2.0]), "")


def test_every_payload_has_a_type() -> None:
    assert set(TYPES) == set(Payload)


def test_mixed_setpoints_keep_their_modes() -> None:
    joints = JointServo((1, 2), vector((0.5, 0.0)), vector((0.0, 0.25)), name=("a", "b"))
    message = TYPES[Payload.JOINT_SERVO]()
    fill(message, joints)
    back = value_of(over_the_wire(message), "")
    assert isinstance(back, JointServo)
    assert (back.modes, back.name) == ((1, 2), ("a", "b"))
    assert (back.position.tolist(), back.velocity.tolist(), back.effort.size) == (
        [0.5, 0.0],
        [0.0, 0.25],
        0,
    )

    turned = vector((0.0, 0.6, 0.0, 0.8))
    axes = CartesianServo(
        (1, 2, 4, 0, 0, 0),
        Pose(vector((1, 2, 3)), turned),
        Twist(vector((4, 5, 6)), vector((7, 8, 9))),
        Wrench(vector((10, 11, 12)), vector((13, 14, 15))),
        Pose(vector((16, 17, 18)), turned),
    )
    message = TYPES[Payload.CARTESIAN_SERVO]()
    fill(message, axes)
    back = value_of(over_the_wire(message), "base")
    assert isinstance(back, CartesianServo)
    assert (back.modes, back.frame_id) == ((1, 2, 4, 0, 0, 0), "base")
    assert back.pose.position.tolist() == [1, 2, 3]
    assert back.twist.vector.tolist() == [4, 5, 6, 7, 8, 9]
    assert back.wrench.vector.tolist() == [10, 11, 12, 13, 14, 15]
    assert back.task.position.tolist() == [16, 17, 18]
    assert back.task.orientation.tolist() == back.pose.orientation.tolist() == turned.tolist()


def test_numbers_and_flags() -> None:
    for payload, value in ((Payload.NUMBER, Number(1)), (Payload.FLAG, Flag(True))):
        message = TYPES[payload]()
        fill(message, value)
        assert value_of(over_the_wire(message), "") == value
