"""What a WSG understands and tells, as data: commands, states, status codes, models.

Source: WSG Command Set Reference Manual, firmware 4.0.x (commands: chapter 3, status codes: appendix A,
system state: appendix B, grasping state: appendix C).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from types import MappingProxyType
from typing import Final, NamedTuple

__all__ = [
    "BUSY",
    "COMMANDS",
    "FAULTS",
    "MODELS",
    "MOTIONS",
    "REFUSALS",
    "STATES",
    "STATUS",
    "Command",
    "Flag",
    "Grasping",
    "Layout",
    "Message",
    "Model",
    "Status",
]


class Command(IntEnum):
    """By the number of the binary protocol."""

    GOODBYE = 0x07
    HOME = 0x20
    MOVE = 0x21
    STOP = 0x22
    FAST_STOP = 0x23
    ACKNOWLEDGE = 0x24
    GRASP = 0x25
    RELEASE = 0x26
    SET_ACCELERATION = 0x30
    SET_FORCE = 0x32
    SET_SOFT_LIMITS = 0x34
    SYSTEM = 0x40
    GRASPING = 0x41
    WIDTH = 0x43
    SPEED = 0x44
    FORCE = 0x45
    LIMITS = 0x53


MOTIONS: Final = frozenset({Command.HOME, Command.MOVE, Command.GRASP, Command.RELEASE})
"""What is answered twice: at once (pending, or refused), and at its end."""


class Layout(NamedTuple):
    """Bytes of a command and of its reply, for `struct`, and what SI units are multiplied by on the wire."""

    request: str = ""
    scales: tuple[float, ...] = ()
    fixed: bytes = b""
    reply: str = ""
    reply_scales: tuple[float, ...] = ()


_MM: Final = 1e3
_UPDATES: Final = ("BH", (1.0, 1e3))  # 0 off, 1 always, 2 on change; period in s

COMMANDS: Mapping[Command, Layout] = MappingProxyType(
    {
        Command.GOODBYE: Layout(),
        Command.HOME: Layout("B", (1.0,)),  # 0 as set, 1 opening, 2 closing
        # Flags 0: absolute, and clamps what is in the way. Sources differ on which bit stops there instead.
        Command.MOVE: Layout("ff", (_MM, _MM), b"\0"),
        Command.STOP: Layout(),
        Command.FAST_STOP: Layout(),
        Command.ACKNOWLEDGE: Layout(fixed=b"ack"),
        Command.GRASP: Layout("ff", (_MM, _MM)),
        Command.RELEASE: Layout("ff", (_MM, _MM)),
        Command.SET_ACCELERATION: Layout("f", (_MM,)),
        Command.SET_FORCE: Layout("f", (1.0,)),
        Command.SET_SOFT_LIMITS: Layout("ff", (_MM, _MM)),
        Command.SYSTEM: Layout(*_UPDATES, reply="I", reply_scales=(1.0,)),
        Command.GRASPING: Layout(*_UPDATES, reply="B", reply_scales=(1.0,)),
        Command.WIDTH: Layout(*_UPDATES, reply="f", reply_scales=(_MM,)),
        Command.SPEED: Layout(*_UPDATES, reply="f", reply_scales=(_MM,)),
        Command.FORCE: Layout(*_UPDATES, reply="f", reply_scales=(1.0,)),
        # Stroke, least and greatest speed, the same of acceleration, least, nominal and overdrive force.
        Command.LIMITS: Layout(reply="8f", reply_scales=(*[_MM] * 5, *[1.0] * 3)),
    }
)


class Message(NamedTuple):
    """What it tells: an update, or the answer to a command. Values in SI units, only with status OK."""

    about: Command
    status: int
    values: tuple[float, ...] = ()


class Flag(IntFlag):
    """Bits of the system state."""

    REFERENCED = 1 << 0
    MOVING = 1 << 1
    BLOCKED = 1 << 2 | 1 << 3
    SOFT_LIMIT = 1 << 4 | 1 << 5
    FAST_STOP = 1 << 12
    WARM = 1 << 13
    TEMPERATURE = 1 << 14
    POWER = 1 << 15
    CURRENT = 1 << 16
    FINGER = 1 << 17
    SCRIPT = 1 << 19
    SCRIPT_FAILED = 1 << 20


FAULTS: Mapping[Flag, tuple[str, str]] = MappingProxyType(
    {
        Flag.TEMPERATURE: ("it is too hot", "Let it cool down, then enable it."),
        Flag.POWER: ("its supply is out of range", "Check the 24 V and the cable, then enable it."),
        Flag.CURRENT: ("overcurrent of its motor", "Free the fingers, then enable it."),
        Flag.FINGER: (
            "a fault of a finger",
            "Check the sensor finger and its plug, then enable it.",
        ),
    }
)
"""What stops it fast by itself, and what to do."""


class Grasping(IntEnum):
    """The grasping state."""

    IDLE = 0
    GRASPING = 1
    NO_PART = 2
    PART_LOST = 3
    HOLDING = 4
    RELEASING = 5
    POSITIONING = 6
    ERROR = 7


STATES: Final = frozenset(Grasping)
BUSY: Final = frozenset({Grasping.GRASPING, Grasping.RELEASING, Grasping.POSITIONING})
"""In which the fingers move."""


class Status(IntEnum):
    """Status codes that mean something to the driver."""

    OK = 0
    NOT_REFERENCED = 3
    RUNNING = 4
    FAILED = 18
    ABORTED = 19
    PENDING = 26
    BLOCKED = 29


_PROGRAM: Final = (
    "It is a mistake of this program, or of a firmware that it does not know: report it."
)
_AGAIN: Final = "Try again; if it stays, switch it off and on."
STATUS: Mapping[int, tuple[str, str]] = MappingProxyType(
    {
        1: ("not available", "The hardware does not have it, or not now."),
        2: ("no sensor", "Connect the sensor finger."),
        3: ("it has not found its reference", "Enable it: it moves to an end of its stroke."),
        4: ("another command is running", "Wait for its end, or stop it (hold)."),
        5: ("not supported", "Is its firmware 2 or newer?"),
        6: ("its settings contradict each other", "Look at soft limits and part width."),
        7: ("it took too long", "Are the fingers free to move?"),
        8: ("it could not read", _AGAIN),
        9: ("it could not write", _AGAIN),
        10: ("it has no memory left", _AGAIN),
        11: ("a frame reached it damaged", "Check cable and baud rate."),
        12: ("a parameter too many", _PROGRAM),
        13: ("a parameter too few", _PROGRAM),
        14: ("unknown command", _PROGRAM),
        15: ("wrong format", _PROGRAM),
        16: (
            "it does not let us",
            "Stopped fast? Enable it. Is another program, or a script, in charge?",
        ),
        17: ("the interface is in use", "End the other program that is connected to it."),
        18: ("it failed", "Was there a part of that width?"),
        19: ("it was broken off", "By a stop, or by another command."),
        20: ("invalid handle", _PROGRAM),
        21: ("not found", _PROGRAM),
        22: ("not open", _PROGRAM),
        23: ("an error of its electronics", _AGAIN),
        24: ("a parameter is wrong", "Look at width, speed and force against its limits."),
        25: ("an index is wrong", _PROGRAM),
        27: ("data came too fast", "Lower rate."),
        28: ("out of range", "Look at width, speed, force and soft limits against its limits."),
        29: ("the fingers are blocked", "Free them; to grip a part use the service grip."),
        30: ("the file exists", _PROGRAM),
    }
)
"""What each code means, and what to do."""
REFUSALS: Final = frozenset(STATUS) - {7, 18, 19, 23, 29}
"""Codes by which a motion is refused before it begins; the others end one."""


@dataclass(frozen=True, slots=True)
class Model:
    """One model; of the stroke between both fingers.

    Attributes:
        stroke: in m.
        speed, acceleration, force: least and greatest, in m/s, m/s² and N.
    """

    stroke: float
    speed: tuple[float, float] = (0.005, 0.42)
    acceleration: tuple[float, float] = (0.1, 5.0)
    force: tuple[float, float] = (5.0, 80.0)


MODELS: Mapping[str, Model] = MappingProxyType(
    {
        "wsg-50-110": Model(0.110),
        "wsg-50-210": Model(0.210),
        "wsg-32-068": Model(0.068, (0.005, 0.4), force=(5.0, 50.0)),
    }
)
"""As their data sheets have them; what the hardware says of itself (command 53) is compared with that."""
