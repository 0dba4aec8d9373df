"""From what a user passes to a command to a value of its payload."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, cast

from crtk_drivers.commands import Command, Payload
from crtk_drivers.conversions import as_pose
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.samples import (
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    Number,
    Pose,
    Twist,
    Value,
    Wrench,
    joint_state,
    vector,
)

_TYPES: Mapping[Payload, type] = MappingProxyType(
    {
        Payload.JOINT_STATE: JointState,
        Payload.POSE: Pose,
        Payload.TWIST: Twist,
        Payload.WRENCH: Wrench,
        Payload.JOINT_SERVO: JointServo,
        Payload.CARTESIAN_SERVO: CartesianServo,
        Payload.NUMBER: Number,
        Payload.FLAG: Flag,
    }
)

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
    }
)


def _six(make: Callable[..., Value]) -> Callable[[Command, Any], Value]:
    def convert(command: Command, value: Any) -> Value:
        numbers = vector(value)
        if numbers.size != 6:
            raise ValueError(f"it has {numbers.size} numbers")
        return make(numbers[:3], numbers[3:])

    return convert


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError("it is neither True nor False")
    return value


_CONVERT: Mapping[Payload, Callable[[Command, Any], Value]] = MappingProxyType(
    {
        Payload.JOINT_STATE: lambda command, value: joint_state(command.kind, vector(value)),
        Payload.POSE: lambda command, value: as_pose(value),
        Payload.TWIST: _six(Twist),
        Payload.WRENCH: _six(Wrench),
        Payload.NUMBER: lambda command, value: Number(float(value)),
        Payload.FLAG: lambda command, value: Flag(_boolean(value)),
    }
)


def value_for(command: Command, value: Any, where: str) -> Value:
    """Return `value` as the payload of `command`.

    Raises:
        CommandRefused: it cannot be one; nothing was sent.
    """
    try:
        if isinstance(value, tuple(_TYPES.values())):
            if not isinstance(value, _TYPES[command.payload]):
                raise TypeError(f"the payload is a {command.payload}")
            return cast("Value", value)
        return _CONVERT[command.payload](command, value)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CommandRefused(
            command.name,
            Reason.WRONG_TYPE,
            f"cannot make a {command.payload} of {type(value).__name__}: {error}",
            where=where,
            remedy=_HELP.get(command.payload, "Pass a ready message of its ROS type."),
        ) from error
