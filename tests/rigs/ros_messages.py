"""Values as ROS messages, field by field: what the bytes that the drivers send and read are compared with."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from crtk_msgs.msg import SetpointMode
from geometry_msgs.msg import Pose as PoseMessage
from std_msgs.msg import MultiArrayDimension

from crtk_drivers.commands import Payload
from crtk_drivers.ros.messages import TYPES
from crtk_drivers.samples import (
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    Joy,
    Matrix,
    Number,
    Numbers,
    Pose,
    Poses,
    Text,
    Twist,
    Value,
    Vector,
    Wrench,
)
from crtk_drivers.state import Status

PAYLOADS: Mapping[type, Payload] = MappingProxyType(
    {
        JointState: Payload.JOINT_STATE,
        Pose: Payload.POSE,
        Poses: Payload.POSES,
        Twist: Payload.TWIST,
        Wrench: Payload.WRENCH,
        Matrix: Payload.MATRIX,
        Number: Payload.NUMBER,
        Flag: Payload.FLAG,
        Numbers: Payload.NUMBERS,
        Text: Payload.TEXT,
        Joy: Payload.JOY,
        JointServo: Payload.JOINT_SERVO,
        CartesianServo: Payload.CARTESIAN_SERVO,
        Status: Payload.OPERATING_STATE,
    }
)


def message_of(value: Value | Status, stamp_ns: int = 0, frame_id: str = "") -> Any:
    """Return the ROS message of a value; one without a header has neither stamp nor frame."""
    message = TYPES[PAYLOADS[type(value)]]()
    if hasattr(message, "header"):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        message.header.frame_id = frame_id
    _FILL[type(value)](message, value)
    return message


def _set(message: Any, numbers: Vector) -> None:
    """Set x, y, z, and w if there is one."""
    for name, number in zip("xyzw", numbers.tolist(), strict=False):
        setattr(message, name, float(number))


def _fill_status(message: Any, status: Status) -> None:
    message.state = status.state.value
    message.is_homed, message.is_busy = status.is_homed, status.is_busy


def _fill_joints(message: Any, value: JointState) -> None:
    message.name = list(value.name)
    message.position = array("d", value.position.tolist())
    message.velocity = array("d", value.velocity.tolist())
    message.effort = array("d", value.effort.tolist())


def _fill_pose(message: Any, value: Pose) -> None:
    _set(message.pose.position, value.position)
    _set(message.pose.orientation, value.orientation)


def _fill_twist(message: Any, value: Twist) -> None:
    _set(message.twist.linear, value.linear)
    _set(message.twist.angular, value.angular)


def _fill_wrench(message: Any, value: Wrench) -> None:
    _set(message.wrench.force, value.force)
    _set(message.wrench.torque, value.torque)


def _fill_matrix(message: Any, value: Matrix) -> None:
    rows, columns = value.values.shape
    message.layout.dim = [
        MultiArrayDimension(label="rows", size=int(rows), stride=int(rows * columns)),
        MultiArrayDimension(label="columns", size=int(columns), stride=int(columns)),
    ]
    message.data = array("d", value.values.ravel().tolist())


def _fill_number(message: Any, value: Number) -> None:
    message.data = float(value.value)


def _fill_flag(message: Any, value: Flag) -> None:
    message.data = bool(value.value)


def _fill_numbers(message: Any, value: Numbers) -> None:
    message.data = array("d", value.values)


def _fill_joy(message: Any, value: Joy) -> None:
    message.axes = list(map(float, value.axes))
    message.buttons = list(value.buttons)


def _fill_text(message: Any, value: Text) -> None:
    message.string = str(value.value)


def _mode(number: int) -> SetpointMode:
    return SetpointMode(value=int(number))


def _fill_poses(message: Any, value: Poses) -> None:
    for pose in value.poses:
        each = PoseMessage()
        _set(each.position, pose.position)
        _set(each.orientation, pose.orientation)
        message.poses.append(each)


def _fill_joint_servo(message: Any, value: JointServo) -> None:
    message.name = list(value.name)
    message.position = array("d", value.position.tolist())
    message.velocity = array("d", value.velocity.tolist())
    message.effort = array("d", value.effort.tolist())
    message.mode = [_mode(number) for number in value.modes]


def _fill_cartesian_servo(message: Any, value: CartesianServo) -> None:
    _set(message.task_frame.translation, value.task.position)
    _set(message.task_frame.rotation, value.task.orientation)
    _set(message.pose.position, value.pose.position)
    _set(message.pose.orientation, value.pose.orientation)
    _set(message.twist.linear, value.twist.linear)
    _set(message.twist.angular, value.twist.angular)
    _set(message.wrench.force, value.wrench.force)
    _set(message.wrench.torque, value.wrench.torque)
    message.axis_mode = [_mode(number) for number in value.modes]


_FILL: Mapping[type, Callable[[Any, Any], None]] = MappingProxyType(
    {
        JointState: _fill_joints,
        Pose: _fill_pose,
        Poses: _fill_poses,
        Twist: _fill_twist,
        Wrench: _fill_wrench,
        Matrix: _fill_matrix,
        Number: _fill_number,
        Flag: _fill_flag,
        Numbers: _fill_numbers,
        Text: _fill_text,
        Joy: _fill_joy,
        JointServo: _fill_joint_servo,
        CartesianServo: _fill_cartesian_servo,
        Status: _fill_status,
    }
)
