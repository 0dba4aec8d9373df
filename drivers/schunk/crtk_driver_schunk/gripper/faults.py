"""What a gripper reports as error and warning, and what to do (enumerations of instances 0x0118, 0x0120)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from crtk_drivers.kit.gripping import Fault, Weight

__all__ = ["ERRORS", "FAST_STOP", "WARNINGS", "fault_of"]

FAST_STOP: Final = 0xD9


_ENABLE = "Enable it, which acknowledges the error."
_HEAT = "Let it cool down. " + _ENABLE
_COLD = "Let it warm up. " + _ENABLE
_SUPPLY = "Check the 24 V and the cable. " + _ENABLE
_SERVICE = "Take its power away and give it back; if it comes again: SCHUNK."
_LIMITS = "Move within its limits. " + _ENABLE
_FREE = "Remove what blocks it. " + _ENABLE

ERRORS: Mapping[int, Fault] = MappingProxyType(
    {
        0x03: Fault("no rights for that", "Its parameters are protected: see its web page."),
        0x04: Fault("an unknown command", _ENABLE),
        0x05: Fault("a command failed", _ENABLE),
        0x12: Fault("a value of a wrong type", _ENABLE),
        0x14: Fault("no authority for that", "Another interface has control: see its web page."),
        0x1B: Fault("a value above its limit", _LIMITS),
        0x1C: Fault("a value below its limit", _LIMITS),
        0x28: Fault("the brake test failed", "Do not rely on its brake. " + _SERVICE),
        0x6C: Fault("the motor is too cold", _COLD),
        0x6D: Fault("the motor is too hot", _HEAT),
        0x70: Fault("the electronics are too cold", _COLD),
        0x71: Fault("the electronics are too hot", _HEAT),
        0x72: Fault("the supply of the electronics is too low", _SUPPLY),
        0x73: Fault("the supply of the electronics is too high", _SUPPLY),
        0x74: Fault("the supply of the motor is too low", _SUPPLY),
        0x75: Fault("the supply of the motor is too high", _SUPPLY),
        0x7C: Fault("it must be started anew", "Use the service soft_reset, or its power."),
        0x7E: Fault("its power stage failed", _SERVICE),
        0x89: Fault("the commutation of its motor was not found", _FREE),
        0x8A: Fault("its encoder: phase", _SERVICE),
        0x8B: Fault("its encoder: sine too low", _SERVICE),
        0x8C: Fault("its encoder: sine too high", _SERVICE),
        0x8D: Fault("its encoder: cosine too low", _SERVICE),
        0x8E: Fault("its encoder: cosine too high", _SERVICE),
        0x8F: Fault("its encoder: short circuit", _SERVICE),
        0xB4: Fault("its encoder: pulses", _SERVICE),
        0xB5: Fault("its encoder: no index", _SERVICE),
        0xB6: Fault("its encoder: several indices", _SERVICE),
        0xB7: Fault("its encoder: impossible Hall signals", _SERVICE),
        0xB8: Fault("its encoder: no Hall signals", _SERVICE),
        0xB9: Fault("its encoder: the absolute value failed", _SERVICE),
        0xBA: Fault("finding the commutation took too long", _FREE),
        0xBB: Fault("finding the commutation failed", _FREE),
        0xD4: Fault("an impossible program step", _ENABLE),
        0xD5: Fault("below its lower soft limit", _LIMITS),
        0xD6: Fault("above its upper soft limit", _LIMITS),
        FAST_STOP: Fault("a fast stop", _ENABLE),
        0xDE: Fault("too much current", _FREE),
        0xDF: Fault("too much current for too long (I²t)", _HEAT),
        0xE1: Fault("an internal error", _SERVICE),
        0xE4: Fault("it moved too fast", _ENABLE),
        0xE7: Fault("its memory could not be written", _SERVICE),
        0xEF: Fault("its fieldbus was lost, or never there", _ENABLE),
        0xF0: Fault("referencing took too long", _FREE),
        0xF1: Fault("a motion took too long", _FREE),
        0xF2: Fault("it is not referenced", "Reference it from its web page. " + _ENABLE),
        0xF4: Fault(
            "a move was blocked",
            "What is to be held is gripped: to the closed end, or with servo_jf. " + _ENABLE,
        ),
        0xF5: Fault("unknown hardware", _SERVICE),
        0xF6: Fault("it was not blocked where it should be", _FREE),
        0xF7: Fault("its parts do not communicate", _SERVICE),
        0xF8: Fault("wrong hardware", _SERVICE),
        0xF9: Fault("a wrong module type", _SERVICE),
        0xFA: Fault("the shutdown failed", _SERVICE),
        0xFB: Fault("its memory was lost", _SERVICE),
        0xFC: Fault("its software does not communicate", _SERVICE),
    }
)
"""By error code."""

WARNINGS: Mapping[int, str] = MappingProxyType(
    {
        0x90: "the electronics are nearly too cold",
        0x91: "the electronics are nearly too hot",
        0x92: "the motor is nearly too cold",
        0x93: "the motor is nearly too hot",
        0x94: "a command is not feasible now",
        0x95: "a position at its limit",
        0x96: "the supply of the electronics is nearly too low",
        0x97: "the supply of the electronics is nearly too high",
        0x98: "the supply of the motor is nearly too low",
        0x99: "the supply of the motor is nearly too high",
        0x9B: "its memory could not be written",
        0x9C: "its memory could not be erased",
        0x9D: "its factory settings could not be restored",
        0x9E: "a wrong password",
        0x9F: "it was not prepared for the last shutdown",
        0xA1: "no part was found",
        0xA2: "its settings were restored from a copy",
    }
)
"""By warning code."""


def fault_of(code: int) -> Fault:
    """Return what an error code means."""
    unknown = Fault("an error that is in no table", "See its manual. " + _ENABLE)
    text, remedy, _ = ERRORS.get(code, unknown)
    return Fault(f"{text} ({code:02X})", remedy, Weight.RESET)
