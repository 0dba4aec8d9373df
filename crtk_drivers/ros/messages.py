"""The core's values and ROS messages: the only place where one becomes the other.

What is sent again and again never is a ROS message: `crtk_drivers.recording.cdr` makes its bytes. Each number
that is put into one passes through `float`, because the generated C code reads the memory of whatever object
lies in a field: an int or a numpy scalar in a float64 field is published as another number, without an error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from builtin_interfaces.msg import Time
from crtk_msgs.msg import CartesianServo as CartesianServoMessage
from crtk_msgs.msg import JointServo as JointServoMessage
from crtk_msgs.msg import OperatingState as OperatingStateMessage
from crtk_msgs.msg import StringStamped
from crtk_msgs.srv import QueryForwardKinematics, QueryInverseKinematics
from geometry_msgs.msg import Pose as PoseMessage
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray

from crtk_drivers.commands import Payload
from crtk_drivers.samples import (
    Flag,
    JointState,
    Number,
    Pose,
    Text,
    Twist,
    Value,
    Vector,
    Wrench,
    vector,
)
from crtk_drivers.state import Status

TYPES: Mapping[Payload, type] = MappingProxyType(
    {
        Payload.JOINT_STATE: JointStateMessage,
        Payload.POSE: PoseStamped,
        Payload.TWIST: TwistStamped,
        Payload.WRENCH: WrenchStamped,
        Payload.MATRIX: Float64MultiArray,
        Payload.OPERATING_STATE: OperatingStateMessage,
        Payload.TEXT: StringStamped,
        Payload.EMPTY: Empty,
        Payload.NUMBER: Float64,
        Payload.FLAG: Bool,
        Payload.NUMBERS: Float64MultiArray,
        Payload.JOINT_SERVO: JointServoMessage,
        Payload.CARTESIAN_SERVO: CartesianServoMessage,
        Payload.FORWARD_KINEMATICS: QueryForwardKinematics,
        Payload.INVERSE_KINEMATICS: QueryInverseKinematics,
    }
)
"""The ROS type of each payload."""

_SECOND = 1_000_000_000


def stamp_ns(stamp: Time) -> int:
    """Return a message's stamp in nanoseconds since the epoch."""
    return int(stamp.sec) * _SECOND + int(stamp.nanosec)


def set_stamp(stamp: Time, nanoseconds: int) -> None:
    """Set a message's stamp; 0 marks invalid data."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, _SECOND)


def _set_xyz(message: Any, values: Vector) -> None:
    x, y, z = values.tolist()
    message.x, message.y, message.z = float(x), float(y), float(z)


def _set_quaternion(message: Any, values: Vector) -> None:
    x, y, z, w = values.tolist()
    message.x, message.y, message.z, message.w = float(x), float(y), float(z), float(w)


def set_pose(message: PoseMessage, pose: Pose) -> None:
    """Fill a geometry_msgs/Pose."""
    _set_xyz(message.position, pose.position)
    _set_quaternion(message.orientation, pose.orientation)


def fill_status(message: OperatingStateMessage, status: Status, nanoseconds: int) -> None:
    """Write what ``operating_state`` says."""
    set_stamp(message.header.stamp, nanoseconds)
    message.state = str(status.state.value)
    message.is_homed = bool(status.is_homed)
    message.is_busy = bool(status.is_busy)


def joints_of(message: JointStateMessage) -> JointState:
    """Return a joint state.

    Raises:
        ValueError: vectors of different sizes.
    """
    return JointState(
        vector(message.position),
        vector(message.velocity),
        vector(message.effort),
        tuple(message.name),
    )


def pose_of(message: PoseMessage, frame_id: str = "") -> Pose:
    """Return a pose; its quaternion is as it came."""
    p, q = message.position, message.orientation
    return Pose(vector((p.x, p.y, p.z)), vector((q.x, q.y, q.z, q.w)), frame_id)


def _xyz(message: Any) -> Vector:
    return vector((message.x, message.y, message.z))


_READ: Mapping[type, Callable[[Any, str], Value]] = MappingProxyType(
    {
        JointStateMessage: lambda message, frame_id: joints_of(message),
        PoseStamped: lambda message, frame_id: pose_of(message.pose, frame_id),
        TwistStamped: lambda message, frame_id: Twist(
            _xyz(message.twist.linear), _xyz(message.twist.angular), frame_id
        ),
        WrenchStamped: lambda message, frame_id: Wrench(
            _xyz(message.wrench.force), _xyz(message.wrench.torque), frame_id
        ),
        Float64: lambda message, frame_id: Number(message.data),
        Bool: lambda message, frame_id: Flag(message.data),
        StringStamped: lambda message, frame_id: Text(message.string),
    }
)


def value_of(message: Any, frame_id: str) -> Value:
    """Return the value of a message that a device publishes, in `frame_id`.

    Raises:
        ValueError: joint values with vectors of different sizes.
    """
    return _READ[type(message)](message, frame_id)
