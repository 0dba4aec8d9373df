"""From what a user passes to a command to a value of its payload."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from numpy.typing import ArrayLike

from crtk_drivers.commands import Command, Kind, Payload
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.conversions import as_pose
from crtk_drivers.samples import (
    VALUE_TYPES,
    Flag,
    JointState,
    Number,
    Numbers,
    Pose,
    Text,
    Twist,
    Value,
    Wrench,
    joint_state,
    vector,
)

JointsLike = ArrayLike | JointState
"""What a command of joints takes."""

PoseLike = Pose | ArrayLike
"""What a command of a pose takes; a PyKDL.Frame and a pinocchio.SE3 too, whose libraries have no types."""

TwistLike = Twist | ArrayLike
"""What a command of a velocity of the tool takes."""

WrenchLike = Wrench | ArrayLike
"""What a command of a force and torque takes."""

_HELP: Mapping[Payload, str] = MappingProxyType(
    {
        Payload.JOINT_STATE: "Pass one number per joint, or a JointState.",
        Payload.POSE: "Pass a Pose, 7 numbers (position and quaternion x, y, z, w), a (4, 4) matrix, "
        "a PyKDL.Frame or a pinocchio.SE3.",
        Payload.TWIST: "Pass a Twist, or 6 numbers: linear and angular velocity.",
        Payload.WRENCH: "Pass a Wrench, or 6 numbers: force and torque.",
        Payload.JOINT_SERVO: "Pass a JointServo.",
        Payload.CARTESIAN_SERVO: "Pass a CartesianServo.",
        Payload.NUMBER: "Pass a number.",
        Payload.FLAG: "Pass True or False.",
        Payload.NUMBERS: "Pass numbers.",
        Payload.TEXT: "Pass a str.",
    }
)


def _six(make: Callable[..., Value]) -> Callable[[Kind, Any], Value]:
    def convert(kind: Kind, value: Any) -> Value:
        numbers = vector(value)
        if numbers.size != 6:
            raise ValueError(f"it has {numbers.size} numbers")
        return make(numbers[:3], numbers[3:])

    return convert


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError("it is neither True nor False")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError("it is no text")
    return value


_CONVERT: Mapping[Payload, Callable[[Kind, Any], Value]] = MappingProxyType(
    {
        Payload.JOINT_STATE: lambda kind, value: joint_state(kind, vector(value)),
        Payload.POSE: lambda kind, value: as_pose(value),
        Payload.TWIST: _six(Twist),
        Payload.WRENCH: _six(Wrench),
        Payload.NUMBER: lambda kind, value: Number(float(value)),
        Payload.FLAG: lambda kind, value: Flag(_boolean(value)),
        Payload.NUMBERS: lambda kind, value: Numbers(tuple(vector(value).tolist())),
        Payload.TEXT: lambda kind, value: Text(_text(value)),
    }
)


def value_for(command: Command, value: Any, where: str) -> Value:
    """Return `value` as the payload of `command`.

    Raises:
        CommandRefused: it cannot be one; nothing was sent.
    """
    return converted(command.name, command.payload, value, where, command.kind)


def converted(
    name: str, payload: Payload, value: Any, where: str, kind: Kind = Kind.POSITION
) -> Value:
    """Return `value` as a payload; `kind` says which field bare numbers of joints fill.

    Raises:
        CommandRefused: it cannot be one.
    """
    try:
        if isinstance(value, tuple(VALUE_TYPES.values())):
            if not isinstance(value, VALUE_TYPES[payload]):
                raise TypeError(f"the payload is a {payload}")
            return value
        return _CONVERT[payload](kind, value)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise CommandRefused(
            name,
            Reason.WRONG_TYPE,
            f"cannot make a {payload} of {type(value).__name__}: {error}",
            where=where,
            remedy=_HELP.get(payload, "Pass a ready message of its ROS type."),
        ) from error
