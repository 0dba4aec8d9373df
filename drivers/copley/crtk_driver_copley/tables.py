"""Parameters of a drive, and what it means by its bits and codes.

Source: ASCII Programmer's Guide (16-01196): parameters, event status (0xa0), trajectory status (0xc9),
latching faults (0xa4), error codes. `VELOCITY`, `FIRMWARE` and `FOLLOWING_LIMIT` are not in it,
but in the Parameter Dictionary (16-01091).
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag
from types import MappingProxyType
from typing import Final, NamedTuple


class Parameter(IntEnum):
    """Those that the driver reads and writes, in counts where nothing else is said."""

    CURRENT = 0x0C  # 0.01 A
    VELOCITY = 0x18  # 0.1 counts/s
    DESIRED_STATE = 0x24
    COMMANDED = 0x2D
    POSITION = 0x32
    BAUD = 0x90  # bit/s
    FIRMWARE = 0x94  # version * 256 + revision
    STATUS = 0xA0
    FAULTS = 0xA4
    FOLLOWING_LIMIT = 0xBA
    HOME_METHOD = 0xC2
    HOME_FAST = 0xC3  # 0.1 counts/s
    HOME_SLOW = 0xC4  # 0.1 counts/s
    HOME_ACCELERATION = 0xC5  # 10 counts/s²
    HOME_OFFSET = 0xC6
    PROFILE = 0xC8
    TRAJECTORY = 0xC9
    GOAL = 0xCA
    PROFILE_VELOCITY = 0xCB  # 0.1 counts/s
    PROFILE_ACCELERATION = 0xCC  # 10 counts/s²
    PROFILE_DECELERATION = 0xCD  # 10 counts/s²
    ABORT_DECELERATION = 0xCF  # 10 counts/s²
    PVT = 0x115


DISABLED: Final = 0
PROGRAMMED_POSITION: Final = 21
"""Desired states: no power, and positions that come over the line."""

TRAPEZOID: Final = 0
PVT_PROFILE: Final = 3
CLEAR_PVT: Final = 0x8000
VELOCITY_UNIT: Final = 0.1  # counts/s
ACCELERATION_UNIT: Final = 10.0  # counts/s²
CURRENT_UNIT: Final = 0.01  # A


class Status(IntFlag):
    """Event status, 0xa0."""

    SHORT = 1 << 0
    DRIVE_HOT = 1 << 1
    OVER_VOLTAGE = 1 << 2
    UNDER_VOLTAGE = 1 << 3
    MOTOR_HOT = 1 << 4
    FEEDBACK = 1 << 5
    PHASING = 1 << 6
    POSITIVE_LIMIT = 1 << 9
    NEGATIVE_LIMIT = 1 << 10
    INPUT_OFF = 1 << 11
    SOFTWARE_OFF = 1 << 12
    PWM_OFF = 1 << 15
    POSITIVE_SOFT = 1 << 16
    NEGATIVE_SOFT = 1 << 17
    TRACKING = 1 << 18
    WAS_RESET = 1 << 20
    LATCHED = 1 << 22
    IN_MOTION = 1 << 27
    COMMAND = 1 << 30


class Trajectory(IntFlag):
    """Trajectory status, 0xc9."""

    HOME_ERROR = 1 << 11
    REFERENCED = 1 << 12
    HOMING = 1 << 13
    ABORTED = 1 << 14
    RUNNING = 1 << 15


class Meaning(NamedTuple):
    """What something is, and what to do about it."""

    text: str
    remedy: str = ""


_POWER: Final = "Check the supply of the drive, and its load."
_COOL: Final = "Let it cool down; check load, cooling and current limits."
_FEEDBACK: Final = (
    "Check the encoder, its cable and its supply (enc clear takes back what it holds)."
)
_PHASE: Final = "Check motor and Hall cables, and phase the motor (CME)."
_SERVICE: Final = (
    "It cannot be cleared: switch the drive off and on; if it stays, the drive needs service."
)
_INPUT: Final = "Close the enable input of the drive, or its safety circuit."
_SWITCH: Final = "Enable, and move away from the switch."
_RANGE: Final = (
    "Enable, and move back; compare the drive's soft limits with the range of the joint."
)

CONDITIONS: Final[Mapping[Status, Meaning]] = MappingProxyType(
    {
        Status.SHORT: Meaning("short circuit", "Check the motor and its cable."),
        Status.DRIVE_HOT: Meaning("drive too hot", _COOL),
        Status.OVER_VOLTAGE: Meaning("over-voltage", _POWER),
        Status.UNDER_VOLTAGE: Meaning("under-voltage", _POWER),
        Status.MOTOR_HOT: Meaning("motor too hot", _COOL),
        Status.FEEDBACK: Meaning("encoder error", _FEEDBACK),
        Status.PHASING: Meaning("phasing error", _PHASE),
        Status.INPUT_OFF: Meaning("its enable input is off", _INPUT),
        Status.SOFTWARE_OFF: Meaning(
            "it was disabled, or has been started anew", "Does another program talk to it? Enable."
        ),
        Status.PWM_OFF: Meaning("its output is off", "Check its enable input and its supply."),
        Status.TRACKING: Meaning(
            "following error", "Is it blocked? Check load, limits and tuning; enable takes it back."
        ),
        Status.COMMAND: Meaning("command fault", "Check the inputs that command the drive (CME)."),
    }
)
"""Bits that no axis with power may show."""

HINDERS: Final = (Status.INPUT_OFF,)
"""Those of them for which an axis gets no power; others may be latched, and `enable` clears them."""

LIMITS: Final[Mapping[Status, Meaning]] = MappingProxyType(
    {
        Status.POSITIVE_LIMIT: Meaning("positive limit switch", _SWITCH),
        Status.NEGATIVE_LIMIT: Meaning("negative limit switch", _SWITCH),
        Status.POSITIVE_SOFT: Meaning("positive soft limit", _RANGE),
        Status.NEGATIVE_SOFT: Meaning("negative soft limit", _RANGE),
    }
)
"""Bits that stop an axis when they appear; it may be enabled and moved away while they are there."""

FAULTS: Final[Mapping[int, Meaning]] = MappingProxyType(
    {
        0: Meaning("flash memory corrupt", _SERVICE),
        1: Meaning("drive internal error", _SERVICE),
        2: Meaning("short circuit", "Check the motor and its cable."),
        3: Meaning("drive too hot", _COOL),
        4: Meaning("motor too hot", _COOL),
        5: Meaning("over-voltage", _POWER),
        6: Meaning("under-voltage", _POWER),
        7: Meaning("encoder error", _FEEDBACK),
        8: Meaning("phasing error", _PHASE),
        9: Meaning("following error", "Is it blocked? Check load, limits and tuning."),
        10: Meaning("over-current", "Check load and current limits."),
        11: Meaning("FPGA failure", _SERVICE),
        12: Meaning("command input lost", "Check the inputs that command the drive (CME)."),
        14: Meaning("safety circuit consistency check failed", "Check the wiring of STO."),
        15: Meaning("current cannot be controlled", "Check motor, cable and current loop tuning."),
        16: Meaning("motor wiring disconnected", "Check the motor cable."),
        18: Meaning("safe torque off is active", _INPUT),
    }
)
"""Latched faults by bit of 0xa4. They are cleared by writing these bits, which only `enable` does."""

NOT_CLEARED: Final = frozenset({0, 1, 11})


def fault_texts(latched: int) -> list[Meaning]:
    """Return what the bits of 0xa4 mean, lowest first."""
    unknown = "See 0xa4 in the manual."
    return [
        FAULTS.get(bit, Meaning(f"latched fault {bit}", unknown))
        for bit in range(latched.bit_length())
        if latched >> bit & 1
    ]


_WAIT: Final = "Let it come to rest first (hold)."
_LIMITS: Final = "Check limits and `counts` of the joint."
_FIRMWARE: Final = "The firmware does not know it: choose another `tracking`, or update it."
_LINE: Final = "Check cable, ground and rate of the line."

ERRORS: Final[Mapping[int, Meaning]] = MappingProxyType(
    {
        1: Meaning("too much data passed with command", _LINE),
        3: Meaning("unknown command code", _FIRMWARE),
        4: Meaning("not enough data was supplied with the command", _LINE),
        5: Meaning("too much data was supplied with the command", _LINE),
        9: Meaning("unknown parameter", _FIRMWARE),
        10: Meaning("data value out of range", _LIMITS),
        11: Meaning("attempt to modify read-only variable", _FIRMWARE),
        14: Meaning("unknown axis state", "Set `axis` of the joint to one that the drive has."),
        15: Meaning("variable does not exist on requested page", _FIRMWARE),
        16: Meaning(
            "illegal serial port forwarding", "Check `node`, and the CAN bus behind the drive."
        ),
        18: Meaning("illegal attempt to start a move while currently moving", _WAIT),
        19: Meaning("illegal velocity limit for move", _LIMITS),
        20: Meaning("illegal acceleration limit for move", _LIMITS),
        21: Meaning("illegal deceleration limit for move", _LIMITS),
        22: Meaning("illegal jerk limit for move", _LIMITS),
        25: Meaning("invalid trajectory mode", _FIRMWARE),
        27: Meaning(
            "command is not allowed while CVM is running", "Stop the program on the drive."
        ),
        31: Meaning("invalid node ID for serial port forwarding", "Check `node` of the joint."),
        32: Meaning("CAN network communications failure", "Check the CAN bus behind the drive."),
        33: Meaning("ASCII command parsing error", _LINE),
        36: Meaning(
            "bad axis letter specified", "Set `axis` of the joint to one that the drive has."
        ),
        46: Meaning("error reading or writing encoder", _FEEDBACK),
        48: Meaning("filter error"),
    }
)
"""By the number of an answer ``e``."""


def error_text(code: int) -> Meaning:
    """Return what an error means."""
    return ERRORS.get(code, Meaning("an error that is not known", "See the manual."))


HOMING: Final[Mapping[str, int]] = MappingProxyType(
    {
        "here": 512,
        "limit_negative": 529,
        "limit_positive": 513,
        "index_positive": 544,
        "index_negative": 560,
        "switch_positive": 514,
        "switch_negative": 530,
        "hard_stop_positive": 516,
        "hard_stop_negative": 532,
    }
)
"""Methods, 0xc2, by the names that they have here."""
