"""What a controller means by its numbers: error codes (TC), stop codes (SC), amplifier status (TA).

Source: Galil command reference, TC, SC and TA.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple


class Refusal(NamedTuple):
    """Why a command was refused, and what to do."""

    text: str
    remedy: str = ""


_POWER: Final = "Enable first; a motor that is off follows nothing."
_WAIT: Final = "Let it come to rest first (hold)."
_PROGRAM: Final = "A program on the controller is in the way: stop it (HX), or change it."
_FIRMWARE: Final = (
    "The firmware does not know the command: choose another `tracking`, or update it."
)
_NETWORK: Final = "Close other clients (TH lists the handles), or restart the controller."

ERRORS: Final[Mapping[int, Refusal]] = MappingProxyType(
    {
        1: Refusal("unrecognized command", _FIRMWARE),
        2: Refusal("valid in a program only", _FIRMWARE),
        3: Refusal("not valid in a program", _PROGRAM),
        4: Refusal("operand error", _FIRMWARE),
        5: Refusal("input buffer full", "Send fewer commands: raise `record_period`."),
        6: Refusal("number out of range", "Check limits and `scale` of the joint."),
        7: Refusal("not valid while running", _WAIT),
        8: Refusal("not valid while not running", _WAIT),
        9: Refusal("variable error"),
        10: Refusal("empty program line or undefined label", _PROGRAM),
        11: Refusal("invalid label or line number", _PROGRAM),
        12: Refusal("subroutine more than 16 deep", _PROGRAM),
        13: Refusal("JG is valid only when running in jog mode", _WAIT),
        14: Refusal("EEPROM check sum error", "Restore the controller's parameters."),
        15: Refusal("EEPROM write error", "The controller needs service."),
        16: Refusal("IP incorrect sign during a move, or given during forced deceleration", _WAIT),
        17: Refusal("ED, BN and DL are not valid while a program runs", _PROGRAM),
        18: Refusal("not valid when contouring", _WAIT),
        19: Refusal("the thread executes already", _PROGRAM),
        20: Refusal("begin is not valid with the motor off", _POWER),
        21: Refusal("begin is not valid while running", _WAIT),
        22: Refusal(
            "begin is not possible due to a limit switch", "Move away from the limit switch."
        ),
        24: Refusal("begin is not valid because no sequence is defined"),
        25: Refusal("variable not given in IN command", _PROGRAM),
        28: Refusal("S operand not valid", _FIRMWARE),
        29: Refusal("not valid during coordinated motion", _WAIT),
        50: Refusal("not enough fields"),
        51: Refusal("question mark not valid", _FIRMWARE),
        52: Refusal("missing quote, or string too long"),
        53: Refusal("error in {}"),
        54: Refusal("question mark is part of a string"),
        55: Refusal("missing [ or []"),
        56: Refusal("array index invalid or out of range"),
        57: Refusal("bad function or array"),
        58: Refusal("bad command response", _FIRMWARE),
        59: Refusal("mismatched parentheses"),
        60: Refusal("download error: line too long or too many lines", _PROGRAM),
        61: Refusal("duplicate or bad label", _PROGRAM),
        62: Refusal("too many labels", _PROGRAM),
        63: Refusal("IF without ENDIF", _PROGRAM),
        66: Refusal("array space full", "Free arrays of programs (DA)."),
        67: Refusal("too many arrays or variables", "Free variables of programs (DA *[], *)."),
        80: Refusal("record mode already running", _PROGRAM),
        81: Refusal("no array or source specified", _PROGRAM),
        82: Refusal("undefined array", _PROGRAM),
        83: Refusal("not a valid number"),
        84: Refusal("too many elements"),
        90: Refusal("only A to H are valid operands", "Check `axis` of each joint."),
        97: Refusal("bad binary command format"),
        98: Refusal("binary commands not valid in a program"),
        99: Refusal("bad binary command number"),
        100: Refusal("not valid when running ECAM", _PROGRAM),
        101: Refusal("improper index into ET", _PROGRAM),
        102: Refusal("no master axis defined for ECAM", _PROGRAM),
        103: Refusal("master axis modulus greater than 256 x EP", _PROGRAM),
        104: Refusal("not valid when axis performs ECAM", _PROGRAM),
        105: Refusal("EB1 command must be given first", _PROGRAM),
        106: Refusal("privilege violation", "Unlock the controller (LC, PW)."),
        110: Refusal("no hall effect sensors detected", "Check the cable of the motor."),
        111: Refusal("must be made brushless by BA", "Configure the axis (BA, BM, BZ)."),
        112: Refusal("BZ command timeout", "Configure the axis (BA, BM, BZ)."),
        113: Refusal("no movement in BZ command", "Check motor and brake."),
        114: Refusal("BZ command runaway", "Check the signs of motor and encoder (MT, CE)."),
        118: Refusal("controller has GL1600, not GL1800"),
        119: Refusal("not valid for an axis configured as stepper", "Check MT of the axis."),
        120: Refusal("bad Ethernet transmit", _NETWORK),
        121: Refusal("bad Ethernet packet received", _NETWORK),
        122: Refusal("Ethernet input buffer overrun", _NETWORK),
        123: Refusal("TCP lost synchronization", _NETWORK),
        124: Refusal("Ethernet handle already in use", _NETWORK),
        125: Refusal("no ARP response from IP address", _NETWORK),
        126: Refusal("closed Ethernet handle", _NETWORK),
        127: Refusal("illegal Modbus function code", _NETWORK),
        128: Refusal("IP address not valid", _NETWORK),
        130: Refusal("remote IOC command error", _NETWORK),
        131: Refusal("serial port timeout"),
        132: Refusal("analog inputs not present"),
        133: Refusal("valid on a UDP handle only, or locked", "Check `udp_port`."),
        134: Refusal("all motors must be in MO for this command", "Disable first."),
        135: Refusal("the motor must be in MO", "Disable first."),
        136: Refusal("invalid password"),
        137: Refusal("invalid lock setting"),
        138: Refusal("passwords not identical"),
        140: Refusal("serial encoder missing", "Check encoder and cable of the axis."),
        141: Refusal("an incorrect feature is not supported", _FIRMWARE),
        143: Refusal("TM timed out"),
        160: Refusal("BX failure", "Configure the sine amplifier (BA, BM, BX)."),
        161: Refusal("sine amplifier axis not initialized", "Configure it (BA, BM, BX)."),
    }
)
"""By error code (TC)."""


def refusal(code: int) -> Refusal:
    """Return what an error code means."""
    return ERRORS.get(code, Refusal("an error that is not known", "See TC in the manual."))


STOPS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0: "it runs, independent mode",
        1: "it has arrived",
        2: "stopped by the forward limit switch or FL",
        3: "stopped by the reverse limit switch or BL",
        4: "stopped by ST",
        6: "stopped by the abort input",
        7: "stopped by AB",
        8: "stopped by off on error (OE1): its position error was more than ER",
        9: "stopped after finding the edge (FE)",
        10: "stopped after homing (HM) or finding the index (FI)",
        11: "stopped by the selective abort input",
        12: "stopped by an encoder failure (OA1)",
        15: "stopped by the amplifier fault",
        16: "stopped by a stepper position error",
        30: "it runs in PVT mode",
        31: "PVT mode has ended normally",
        32: "PVT mode has ended because the buffer is empty",
        50: "it runs in contour mode",
        51: "contour mode has stopped",
        99: "MC timed out",
        100: "it runs, vector sequence",
        101: "vector sequence has stopped",
    }
)
"""By stop code (SC)."""

FAULTS: Final = frozenset({2, 3, 6, 7, 8, 11, 12, 15, 16})
"""Stop codes of an axis that did not stop because it should."""

HOMED: Final = 10
EMPTY: Final = frozenset({31, 32})
STOPPED: Final = 4


def stop_text(code: int) -> str:
    """Return what a stop code means."""
    return STOPS.get(code, "stopped for a reason that is not known")


_AMPLIFIER: Final = ("over-current", "over-voltage", "over-temperature", "under-voltage")


LASTS: Final = 0b1110_1110
"""Bits of `_AMPLIFIER` that last as long as their cause, for axes A to D and E to H.

Over-current is left out: it is latched until the motor is switched off and on."""


def amplifier_text(status: int, axis: int) -> str:
    """Return what the amplifier of an axis says; empty if nothing is wrong.

    Args:
        status: 32 bits, of the record.
        axis: 0 for A.
    """
    shift = 4 if axis >= 4 else 0
    words = [text for bit, text in enumerate(_AMPLIFIER) if status >> bit + shift & 1]
    if status >> 8 + axis & 1:
        words.append("hall error")
    if status >> 16 + axis & 1:
        words.append("peak current")
    if status >> (25 if axis >= 4 else 24) & 1:
        words.append("electronic lock-out (ELO)")
    return ", ".join(words)
