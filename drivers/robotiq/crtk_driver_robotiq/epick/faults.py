"""The faults that the vacuum gripper reports, and what to do (ePick instruction manual, 4.5)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from crtk_driver_robotiq.epick.registers import Status
from crtk_drivers.kit.gripping import Fault, Weight

__all__ = ["FAULTS", "fault_of"]

_ANEW = "Remove the cause, and enable it: it is activated anew, which lets go."

FAULTS: Mapping[int, Fault] = MappingProxyType(
    {
        0x3: Fault(
            "the object is porous or leaks: the pump does not rest (3)",
            "Use another cup, or less vacuum.",
            Weight.PASSES,
        ),
        0x5: Fault("its activation is not finished (5)", "Enable it.", Weight.INACTIVE),
        0x6: Fault("nothing was gripped in time (6)", "", Weight.PASSES),
        0x7: Fault("it is not activated (7)", "Enable it.", Weight.INACTIVE),
        0x8: Fault("it is too hot (8)", "Let it cool down.", Weight.STOPS),
        0x9: Fault("it heard nothing for a second (9)", "", Weight.PASSES),
        0xA: Fault(
            "its supply is too low (A)", "Check the 24 V and the cable. " + _ANEW, Weight.RESET
        ),
        0xB: Fault("an automatic release is under way (B)", _ANEW, Weight.RESET),
        0xC: Fault("an internal fault (C)", _ANEW + " If it comes again: Robotiq.", Weight.RESET),
        0xF: Fault("an automatic release has ended (F)", _ANEW, Weight.RESET),
    }
)
"""By gFLT."""


def fault_of(status: Status) -> Fault | None:
    """Return the fault that is told; an unknown code stops it."""
    if not status.fault:
        return None
    unknown = Fault(f"gripper fault {status.fault:X}", "See the manual.", Weight.STOPS)
    return FAULTS.get(status.fault, unknown)
