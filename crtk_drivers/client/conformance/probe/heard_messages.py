"""ROS messages as the plain values that the judges read; nothing is checked on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from crtk_drivers.client.conformance.observed import (
    CartesianHeard,
    JointsHeard,
    MatrixHeard,
    StateHeard,
)
from crtk_drivers.commands import Payload
from crtk_drivers.ros.messages import stamp_ns


@dataclass(frozen=True, slots=True)
class Raw:
    """A message as it arrived, and when: monotonic s, and ns since the epoch."""

    at: float
    wall_ns: int
    message: Any


def joints_heard(raw: Raw) -> JointsHeard:
    """Return a JointState."""
    m = raw.message
    return JointsHeard(
        *_header(raw), tuple(m.name), tuple(m.position), tuple(m.velocity), tuple(m.effort)
    )


def cartesian_heard(raw: Raw, payload: Payload) -> CartesianHeard:
    """Return a PoseStamped, TwistStamped or WrenchStamped."""
    if payload is Payload.POSE:
        pose = raw.message.pose
        numbers: tuple[float, ...] = (
            *_xyz(pose.position),
            *_xyz(pose.orientation),
            float(pose.orientation.w),
        )
    elif payload is Payload.TWIST:
        twist = raw.message.twist
        numbers = (*_xyz(twist.linear), *_xyz(twist.angular))
    else:
        wrench = raw.message.wrench
        numbers = (*_xyz(wrench.force), *_xyz(wrench.torque))
    return CartesianHeard(*_header(raw), numbers)


def transforms_heard(raw: Raw) -> list[CartesianHeard]:
    """Return the transforms of a TFMessage."""
    found = []
    for each in raw.message.transforms:
        p, q = each.transform.translation, each.transform.rotation
        numbers = (*_xyz(p), *_xyz(q), float(q.w))
        stamp, frame = stamp_ns(each.header.stamp), each.header.frame_id
        found.append(
            CartesianHeard(raw.at, raw.wall_ns, stamp, frame, numbers, each.child_frame_id)
        )
    return found


def matrix_heard(raw: Raw) -> MatrixHeard:
    """Return a Float64MultiArray."""
    sizes = tuple(each.size for each in raw.message.layout.dim)
    return MatrixHeard(raw.at, raw.wall_ns, 0, "", sizes, tuple(raw.message.data))


def state_heard(raw: Raw) -> StateHeard:
    """Return an OperatingState."""
    m = raw.message
    return StateHeard(*_header(raw), m.state, bool(m.is_homed), bool(m.is_busy))


def _header(raw: Raw) -> tuple[float, int, int, str]:
    header = raw.message.header
    return raw.at, raw.wall_ns, stamp_ns(header.stamp), header.frame_id


def _xyz(message: Any) -> tuple[float, float, float]:
    return float(message.x), float(message.y), float(message.z)
