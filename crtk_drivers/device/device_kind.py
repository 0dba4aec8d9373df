"""Kinds of devices, as people speak of them: a plugin says of which one its device is."""

from __future__ import annotations

from enum import StrEnum


class DeviceKind(StrEnum):
    """What a device is to the program that uses it: which commands a type checker lets pass.

    The value is the name of its class in `crtk_drivers.front.kinds`.
    """

    ARM = "Arm"
    GRIPPER = "Gripper"
    FORCE_SENSOR = "ForceSensor"
    TRACKER = "Tracker"
    HAPTIC = "HapticDevice"
    INPUT = "InputDevice"
    ANY = "AnyDevice"


def class_name(plugin: str) -> str:
    """Return the class of a plugin in `crtk_drivers.front.local_devices`: ``AtiNetft`` of ``ati-netft``."""
    return "".join(word.capitalize() for word in plugin.split("-"))
