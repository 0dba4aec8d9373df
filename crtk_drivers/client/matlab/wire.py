"""Values as they travel between MATLAB and Python. Pure.

An array is ``{"size": [rows, columns], "data": "0.1,0.2,"}``: its numbers by column, in decimal digits that
give the same number again. So nothing hangs on how a JSON library writes NaN, or an array of one number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from crtk_drivers.commands import Command, Kind, Payload
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.front.payloads import value_for
from crtk_drivers.geometry.conversions import as_pose, to_matrix
from crtk_drivers.geometry.quaternions import QUATERNION_TOLERANCE
from crtk_drivers.samples import (
    EMPTY,
    Array,
    CartesianServo,
    JointServo,
    JointState,
    Matrix,
    Number,
    Pose,
    Poses,
    Twist,
    Value,
    Vector,
    Wrench,
    vector,
)

Encoded = Mapping[str, Any]


def encoded(array: Array) -> dict[str, Any]:
    """Return an array by its columns, as MATLAB keeps it; one of one dimension is a column."""
    array = np.asarray(array, dtype=np.float64)
    if array.ndim < 2:
        array = array.reshape(-1, 1)
    data = "".join(f"{_text(number)}," for number in array.flatten(order="F").tolist())
    return {"size": list(array.shape), "data": data}


def _text(number: float) -> str:
    if math.isnan(number):
        return "NaN"
    if math.isinf(number):
        return "Inf" if number > 0.0 else "-Inf"
    return repr(number)


def decoded(part: Encoded) -> Array:
    """Return the array; rows and columns alike have one dimension.

    Raises:
        ValueError: it is none.
    """
    numbers = np.array([float(text) for text in part["data"].split(",") if text])
    array = numbers.reshape([int(size) for size in part["size"]], order="F")
    return array.ravel() if array.ndim == 2 and min(array.shape) <= 1 else array


def parts_of(value: Any) -> list[Array]:
    """Return a value as the outputs of a MATLAB function: joints in columns, axes in rows."""
    match value:
        case JointState():
            return [value.position, value.velocity, value.effort]
        case Pose():
            return [to_matrix(value)]
        case Poses():
            matrices = [to_matrix(pose) for pose in value.poses]
            return [np.stack(matrices, axis=2) if matrices else np.empty((4, 4, 0))]
        case Twist() | Wrench():
            return [value.vector.reshape(1, 6)]
        case Matrix():
            return [value.values]
        case Number():
            return [np.array([value.value])]
        case _:
            return [value]


_COUNTS: Mapping[Payload, tuple[int, int]] = MappingProxyType(
    {
        Payload.EMPTY: (0, 0),
        Payload.JOINT_SERVO: (2, 4),
        Payload.CARTESIAN_SERVO: (5, 5),
        Payload.INVERSE_KINEMATICS: (1, 2),
    }
)
"""How many arguments a method takes in MATLAB, if not one."""
_EXPECTED: Mapping[Payload, str] = MappingProxyType(
    {
        Payload.JOINT_STATE: "one number for each joint",
        Payload.POSE: "a 4x4 homogeneous matrix, or position and quaternion x, y, z, w",
        Payload.TWIST: "6 numbers: linear and angular velocity",
        Payload.WRENCH: "6 numbers: force and torque",
        Payload.JOINT_SERVO: "modes, positions, velocities, efforts: one number for each joint in each",
        Payload.CARTESIAN_SERVO: "6 modes, a 4x4 pose, 6 velocities, 6 forces, a 4x4 task frame",
        Payload.NUMBER: "a number",
        Payload.FLAG: "true or false",
        Payload.EMPTY: "nothing",
        Payload.FORWARD_KINEMATICS: "one number for each joint",
        Payload.INVERSE_KINEMATICS: "a 4x4 pose, and joint positions near which to look",
    }
)


def arguments_of(
    command: Command, arrays: Sequence[Array], where: str
) -> tuple[Value | Vector, ...]:
    """Return what the method of a CRTK name takes, from what was passed to it in MATLAB.

    A joint position may be followed by the velocity that belongs to it.

    Raises:
        CommandRefused: it takes something else.
    """
    least, most = _COUNTS.get(command.payload, (1, 1))
    if command.payload is Payload.JOINT_STATE and command.kind is Kind.POSITION:
        most = 2
    try:
        if not least <= len(arrays) <= most:
            raise ValueError(f"{len(arrays)} arguments")
        if command.payload is Payload.INVERSE_KINEMATICS:
            return (pose(arrays[0]), *map(vector, arrays[1:]))
        if command.payload is Payload.FORWARD_KINEMATICS:
            return (vector(arrays[0]),)
        return (_value(command, arrays, where),) if arrays else ()
    except (TypeError, ValueError) as error:
        detail = error.detail if isinstance(error, CommandRefused) else str(error)
        raise CommandRefused(
            command.name,
            Reason.WRONG_TYPE,
            detail,
            where=where,
            remedy=f"Pass {_EXPECTED[command.payload]}.",
        ) from error


def _value(command: Command, arrays: Sequence[Array], where: str) -> Value:
    first = arrays[0]
    match command.payload:
        case Payload.POSE:
            return pose(first)
        case Payload.JOINT_SERVO:
            position, velocity, effort = (*arrays[1:], EMPTY, EMPTY)[:3]
            return JointServo(_modes(first), position, velocity, effort)
        case Payload.CARTESIAN_SERVO:
            twist, wrench = _six(arrays[2]), _six(arrays[3])
            return CartesianServo(
                _modes(first),
                pose(arrays[1]),
                Twist(twist[:3], twist[3:]),
                Wrench(wrench[:3], wrench[3:]),
                pose(arrays[4]),
            )
        case Payload.JOINT_STATE if len(arrays) == 2:
            return JointState(first, arrays[1])
        case Payload.FLAG | Payload.NUMBER:
            if first.size != 1:
                raise ValueError(f"{first.size} numbers")
            number = float(first[0])
            is_flag = command.payload is Payload.FLAG and number in (0.0, 1.0)
            return value_for(command, bool(number) if is_flag else number, where)
        case _:
            return value_for(command, first, where)


def pose(array: Array) -> Pose:
    """Return the pose of a homogeneous matrix, or of position and quaternion.

    Raises:
        ValueError: it is none.
    """
    if array.shape == (4, 4):
        rotation = array[:3, :3]
        error = float(np.max(np.abs(rotation.T @ rotation - np.eye(3))))
        if not error <= QUATERNION_TOLERANCE or np.linalg.det(rotation) < 0.0:
            raise ValueError("the upper left 3x3 part is no rotation matrix")
    return as_pose(array)


def _six(array: Array) -> Array:
    if array.shape != (6,):
        raise ValueError(f"an array of shape {array.shape} where 6 numbers belong")
    return array


def _modes(array: Array) -> tuple[int, ...]:
    if array.ndim != 1 or not np.all(array == np.round(array)):
        raise ValueError("modes are whole numbers: 0 none, 1 position, 2 velocity, 4 effort")
    return tuple(int(number) for number in array)
