"""The core's values and ROS messages: the only place where one becomes the other.

What is sent again and again, and what is heard, is never a ROS message: `crtk_drivers.recording.cdr` makes
and reads its bytes. What is put into a message is a Python float, because the generated C code reads the
memory of whatever object lies in a field: an int or a numpy scalar in a float64 field is published as another
number, without an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from builtin_interfaces.msg import Time
from crtk_msgs.msg import OperatingState as OperatingStateMessage
from geometry_msgs.msg import Pose as PoseMessage

from crtk_drivers.commands import ROS_TYPES, Payload
from crtk_drivers.ros.plain import message_class
from crtk_drivers.samples import Pose, vector
from crtk_drivers.state import Status

TYPES: Mapping[Payload, type] = MappingProxyType(
    {payload: message_class(name) for payload, name in ROS_TYPES.items()}
)
"""The ROS class of each payload."""

_SECOND = 1_000_000_000


def stamp_ns(stamp: Time) -> int:
    """Return a message's stamp in nanoseconds since the epoch."""
    return int(stamp.sec) * _SECOND + int(stamp.nanosec)


def set_stamp(stamp: Time, nanoseconds: int) -> None:
    """Set a message's stamp; 0 marks invalid data."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, _SECOND)


def set_pose(message: PoseMessage, pose: Pose) -> None:
    """Fill a geometry_msgs/Pose."""
    p, q = message.position, message.orientation
    p.x, p.y, p.z = pose.position.tolist()
    q.x, q.y, q.z, q.w = pose.orientation.tolist()


def fill_status(message: OperatingStateMessage, status: Status, nanoseconds: int) -> None:
    """Write what ``operating_state`` says."""
    set_stamp(message.header.stamp, nanoseconds)
    message.state = str(status.state.value)
    message.is_homed = bool(status.is_homed)
    message.is_busy = bool(status.is_busy)


def pose_of(message: PoseMessage, frame_id: str = "") -> Pose:
    """Return a pose; its quaternion is as it came."""
    p, q = message.position, message.orientation
    return Pose(vector((p.x, p.y, p.z)), vector((q.x, q.y, q.z, q.w)), frame_id)
