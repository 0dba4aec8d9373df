"""The faults that a gripper and its controller report, and what to do (manual 4.5; SDK fault_status)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from crtk_driver_robotiq.registers import Status
from crtk_drivers.kit.gripping import Fault, Weight

__all__ = ["CONTROLLER", "GRIPPER", "fault_of"]


_ANEW = (
    "Remove the cause, take out what it holds, and enable it: it is activated anew, which opens it."
)

GRIPPER: Mapping[int, Fault] = MappingProxyType(
    {
        0x5: Fault("its activation is not finished (5)", "Enable it.", Weight.INACTIVE),
        0x7: Fault("it is not activated (7)", "Enable it.", Weight.INACTIVE),
        0x8: Fault("it is too hot (8)", "Let it cool down, below 80 °C inside.", Weight.STOPS),
        0x9: Fault("it heard nothing for a second (9)", "", Weight.PASSES),
        0xA: Fault(
            "its supply is too low (A)", "Check the 24 V and the cable. " + _ANEW, Weight.RESET
        ),
        0xB: Fault("an automatic release is under way (B)", _ANEW, Weight.RESET),
        0xC: Fault("an internal fault (C)", _ANEW + " If it comes again: Robotiq.", Weight.RESET),
        0xD: Fault(
            "its activation failed (D)",
            "Nothing may hinder the fingers from opening and closing fully. " + _ANEW,
            Weight.RESET,
        ),
        0xE: Fault("overcurrent (E)", _ANEW, Weight.RESET),
        0xF: Fault("an automatic release has ended (F)", _ANEW, Weight.RESET),
    }
)
"""By gFLT."""

CONTROLLER: Mapping[int, Fault] = MappingProxyType(
    {
        0x4: Fault("its controller has no 24 V", "Check the supply.", Weight.STOPS),
        0x5: Fault("its controller finds no gripper", "Check the cable.", Weight.STOPS),
        0x9: Fault("its controller is booting", "Wait.", Weight.STOPS),
        0xC: Fault("its controller is stopped (emergency stop)", "Release it.", Weight.STOPS),
        0xE: Fault("overcurrent at its controller", "Remove what blocks it.", Weight.STOPS),
    }
)
"""By kFLT."""


def fault_of(status: Status) -> Fault | None:
    """Return the fault that counts; an unknown code stops it."""
    for name, code, known in (
        ("controller", status.controller_fault, CONTROLLER),
        ("gripper", status.fault, GRIPPER),
    ):
        if code:
            unknown = Fault(f"{name} fault {code:X}", "See the manual.", Weight.STOPS)
            return known.get(code, unknown)
    return None
