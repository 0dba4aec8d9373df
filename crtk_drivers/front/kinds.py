"""Kinds of devices, for annotations: ``def park(arm: crtk_drivers.Arm) -> None``.

The methods of each kind are in `kinds.pyi`, for type checkers and editors: those that a device of this kind
may have. At run time a device has those that it offers, see `Operated.crtk_commands`; `isinstance` does not
tell its kind, and raises TypeError.
"""

from __future__ import annotations

from typing import Protocol

from crtk_drivers.front.base import Operated


class SomeDevice(Operated, Protocol):
    """What devices of all kinds have."""


class InputDevice(SomeDevice, Protocol):
    """Pedals, a joystick or a six-axis mouse."""


class Tracker(SomeDevice, Protocol):
    """A camera or a field generator that sees markers; each tool that it tracks is a `child`."""


class ForceSensor(SomeDevice, Protocol):
    """A sensor of force and torque."""


class Moving(SomeDevice, Protocol):
    """A device that moves."""


class JointMotion(Moving, Protocol):
    """A device that moves its joints."""


class CartesianMotion(Moving, Protocol):
    """A device that moves a tool in space."""


class Gripper(JointMotion, Protocol):
    """Fingers, jaws or a vacuum gripper."""


class HapticDevice(CartesianMotion, Protocol):
    """A device that a hand holds, and that pushes back."""


class Arm(JointMotion, CartesianMotion, Protocol):
    """An arm, or axes that are driven as one."""


class AnyDevice(Arm, Tracker, ForceSensor, Protocol):
    """A device of a kind that is not known: a type checker lets every command pass."""
