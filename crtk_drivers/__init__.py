"""crtk-drivers: hardware drivers that speak CRTK, on ROS 2 and in plain Python."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crtk_drivers.client.lab_devices import LabDevices, lab
    from crtk_drivers.errors import CommandRefused, CrtkError
    from crtk_drivers.front import LocalDevice, connect
    from crtk_drivers.front.kinds import (
        AnyDevice,
        Arm,
        ForceSensor,
        Gripper,
        HapticDevice,
        InputDevice,
        Tracker,
    )
    from crtk_drivers.samples import JointState, Pose, Twist, Wrench

__all__ = [
    "AnyDevice",
    "Arm",
    "CommandRefused",
    "CrtkError",
    "ForceSensor",
    "Gripper",
    "HapticDevice",
    "InputDevice",
    "JointState",
    "LabDevices",
    "LocalDevice",
    "Pose",
    "Tracker",
    "Twist",
    "Wrench",
    "connect",
    "lab",
]

# Imported when first used: `crtk-driver --help` needs none of it.
_MODULES = {
    "AnyDevice": "front.kinds",
    "Arm": "front.kinds",
    "CommandRefused": "errors",
    "CrtkError": "errors",
    "ForceSensor": "front.kinds",
    "Gripper": "front.kinds",
    "HapticDevice": "front.kinds",
    "InputDevice": "front.kinds",
    "JointState": "samples",
    "LabDevices": "client.lab_devices",
    "LocalDevice": "front",
    "Pose": "samples",
    "Tracker": "front.kinds",
    "Twist": "samples",
    "Wrench": "samples",
    "connect": "front",
    "lab": "client.lab_devices",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
