"""CRTK's values as bodies of OpenIGTLink, and back: as sawOpenIGTLink maps them. Pure.

Lengths of poses are `scale` times m: 1000 for 3D Slicer and Plus, which take mm, 1 for sawOpenIGTLink. All
else is SI: joints, velocities, forces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from crtk_drivers.commands import Command, Payload
from crtk_drivers.front.openigtlink.bodies import (
    Body,
    NdArray,
    Position,
    QuaternionTrackingData,
    Sensor,
    String,
    Tracked,
    TrackingData,
    Transform,
)
from crtk_drivers.geometry.conversions import as_pose, to_matrix
from crtk_drivers.geometry.quaternions import quaternion_from_matrix
from crtk_drivers.samples import Array, JointState, Pose, Poses, Text, Value, Vector, vector

MILLIMETRES: Final = 1000.0
METRES: Final = 1.0

TOLD: Final = frozenset(
    {Payload.JOINT_STATE, Payload.POSE, Payload.POSES, Payload.TWIST, Payload.WRENCH}
)
"""What can be told."""


def scaled(matrix: Array, scale: float) -> Array:
    """Return a homogeneous matrix (4, 4) with its translation in another unit."""
    result = np.array(matrix)
    result[:3, 3] *= scale
    return result


def body_of(value: Value, scale: float) -> Body:
    """Return a value as it is told.

    Args:
        value: of one of the payloads in `TOLD`.
        scale: of lengths of poses.
    """
    match value:
        case Pose():
            return Transform(scaled(to_matrix(value), scale))
        case Poses():
            return TrackingData(
                tuple(
                    Tracked(f"{number}", scaled(to_matrix(pose), scale))
                    for number, pose in enumerate(value.poses, 1)
                )
            )
        case JointState():
            return NdArray(_joints(value))
        case Text():
            return String(value.value)
        case _:
            numbers: Vector = value.vector  # type: ignore[union-attr]
            return Sensor(vector(numbers))


def _joints(state: JointState) -> Array:
    """Return (6, n): whether positions are valid, positions, and the same of velocities and efforts."""
    parts = (state.position, state.velocity, state.effort)
    count = max(len(state.name), *(part.size for part in parts))
    rows = np.zeros((6, count))
    for index, part in enumerate(parts):
        if part.size:
            rows[2 * index], rows[2 * index + 1] = 1.0, part
    return rows


def as_type(kind: str, transform: Transform, name: str) -> Body | None:
    """Return a pose as a body of another type, None if it cannot be one.

    Args:
        kind: TRANSFORM, POSITION, TDATA or QTDATA.
        transform: the pose.
        name: of the tool, for the last two.
    """
    tool = Tracked(name, transform.matrix)
    match kind:
        case "TRANSFORM":
            return transform
        case "POSITION":
            turned = quaternion_from_matrix(transform.matrix[:3, :3])
            return Position(vector(transform.matrix[:3, 3]), turned)
        case "TDATA":
            return TrackingData((tool,))
        case "QTDATA":
            return QuaternionTrackingData((tool,))
    return None


# -------------------------------------------------------------------------------------------- commands


def _pose(body: Body, scale: float) -> Pose:
    if isinstance(body, Transform):
        return as_pose(scaled(body.matrix, 1.0 / scale))
    if isinstance(body, Position) and body.orientation is not None:
        return Pose(vector(body.position / scale), body.orientation)
    raise TypeError("give a TRANSFORM, or a POSITION with a quaternion")


def _numbers(body: Body, scale: float) -> Vector:
    if isinstance(body, Sensor):
        return body.values
    if isinstance(body, NdArray) and body.values.ndim == 1 and body.values.dtype.kind != "c":
        return vector(body.values.astype(np.float64))
    raise TypeError("give a SENSOR, or an NDARRAY of one dimension")


def _text(body: Body, scale: float) -> str:
    if isinstance(body, String):
        return body.text.strip()
    raise TypeError("give a STRING")


_TAKEN: Final[Mapping[Payload, Callable[[Body, float], Any]]] = MappingProxyType(
    {
        Payload.JOINT_STATE: _numbers,
        Payload.POSE: _pose,
        Payload.TWIST: _numbers,
        Payload.WRENCH: _numbers,
        Payload.TEXT: _text,
        Payload.EMPTY: lambda body, scale: None,
    }
)
"""By the payload of a command: what makes its value of a body."""


def is_taken(command: Command) -> bool:
    """Whether a command can come as a message."""
    return command.payload in _TAKEN


def value_of(command: Command, body: Body, scale: float) -> Any:
    """Return what a command is called with; None for one that takes nothing.

    Raises:
        TypeError, ValueError: a body of another type, or one that holds no such value.
    """
    return _TAKEN[command.payload](body, scale)
