"""What values of a device can be drawn over time: its numbers, with their names and units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from crtk_drivers.commands import Payload
from crtk_drivers.geometry.quaternions import rotvec_from_quaternion
from crtk_drivers.samples import (
    Flag,
    JointState,
    Number,
    Numbers,
    Pose,
    Twist,
    Value,
    Wrench,
)

__all__ = ["DRAWN", "Trace", "traces_of"]

DRAWN: Final = frozenset(
    {
        Payload.JOINT_STATE,
        Payload.POSE,
        Payload.TWIST,
        Payload.WRENCH,
        Payload.NUMBER,
        Payload.NUMBERS,
        Payload.FLAG,
    }
)
"""Payloads that have numbers to draw."""

_AXES: Final = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Trace:
    """Numbers of one unit that belong together: ``position`` of ``measured_js``."""

    part: str
    unit: str
    names: tuple[str, ...]
    values: tuple[float, ...]


def traces_of(value: Value, units: str = "") -> list[Trace]:
    """Return the numbers of a value; what it does not hold is left out.

    Args:
        value: of a feedback or a reading.
        units: of a value that is a bare number.
    """
    match value:
        case JointState():
            count = max(value.position.size, value.velocity.size, value.effort.size)
            names = value.name or tuple(str(i + 1) for i in range(count))
            parts = (
                ("position", "rad (m)", value.position),
                ("velocity", "rad/s (m/s)", value.velocity),
                ("effort", "N·m (N)", value.effort),
            )
            return [
                Trace(part, unit, names, tuple(numbers.tolist()))
                for part, unit, numbers in parts
                if numbers.size
            ]
        case Pose():
            rotation = rotvec_from_quaternion(value.orientation)
            return [
                Trace("position", "m", _AXES, tuple(value.position.tolist())),
                Trace("rotation", "rad", _AXES, tuple(rotation.tolist())),
            ]
        case Twist():
            return [
                Trace("linear", "m/s", _AXES, tuple(value.linear.tolist())),
                Trace("angular", "rad/s", _AXES, tuple(value.angular.tolist())),
            ]
        case Wrench():
            return [
                Trace("force", "N", _AXES, tuple(value.force.tolist())),
                Trace("torque", "N·m", _AXES, tuple(value.torque.tolist())),
            ]
        case Number() | Flag():
            return [Trace("", units, ("value",), (float(value.value),))]
        case Numbers():
            names = tuple(str(i + 1) for i in range(len(value.values)))
            return [Trace("", units, names, tuple(value.values))]
    return []
