"""The devices: what each has, and how strong it is.

The numbers of `Model.types` are those of forcedimension-core (for SDK 3.14 to 3.16), but that of delta.6,
which is of older headers. **Forces, torques and grips are from memory**: none was compared with a data sheet,
so nothing beyond them is let through, and of two numbers that are remembered it is the smaller one. Give the
device's own as `max_force`, `max_torque` and `max_grip`, where they are less.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

__all__ = ["MODELS", "Model"]


@dataclass(frozen=True, slots=True)
class Model:
    """One device.

    Attributes:
        types: numbers by which the library knows it (dhdGetSystemType), both hands.
        force: N, that it is taken to keep up.
        torque: N·m; 0: its wrist, if it has one, has no motors.
        grip: N; 0: its gripper, if it has one, has no motor.
        has_gripper: it tells an angle.
        buttons: names of the bits of its buttons, from the lowest.
    """

    types: tuple[int, ...]
    force: float
    torque: float = 0.0
    grip: float = 0.0
    has_gripper: bool = False
    buttons: tuple[str, ...] = ("button",)


MODELS: Final[Mapping[str, Model]] = MappingProxyType(
    {
        "omega.3": Model((33,), 12.0),
        "omega.6": Model((34, 36), 12.0),
        "omega.7": Model((35, 37), 12.0, grip=8.0, has_gripper=True),
        "delta.3": Model((63,), 20.0),
        "delta.6": Model((64,), 20.0, torque=0.15),
        "sigma.7": Model((104, 105), 20.0, torque=0.4, grip=8.0, has_gripper=True),
        "lambda.7": Model((108, 109), 20.0, torque=0.2, grip=8.0, has_gripper=True),
        "falcon": Model((60,), 8.0, buttons=("center", "left", "top", "right")),
    }
)
"""By name."""
