"""The process image of 16 bytes, the same by every way: commands in, bytes out, status back. Pure: no I/O.

Sources: fieldbus manuals of EGU, EGK and EZU, "control double word" and "status double word"; SCHUNK's own
driver library (schunk_egu_egk_gripper, driver.py).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntFlag
from typing import Final, Literal

__all__ = ["CONTROL", "IDLE", "SIZE", "STATUS", "Command", "Control", "Order", "State", "Status"]

STATUS: Final = 0x0040
CONTROL: Final = 0x0048
"""Instances of both images."""
SIZE: Final = 16
"""Bytes of an image."""

Order = Literal["<", ">"]
"""Of the bytes of each 32-bit number: big-endian in PROFINET modules only."""

MICRO: Final = 1e-6


class Control(IntFlag):
    """The control double word. Never sent, and not here: manual release, relative and repeated moves."""

    RUN = 1 << 0
    """Inverted: without it, a fast stop."""
    STOP = 1 << 1
    ACKNOWLEDGE = 1 << 2
    SOFT_RESET = 1 << 4
    OUTWARD = 1 << 7
    RELEASE = 1 << 11
    GRIP = 1 << 12
    MOVE = 1 << 13
    BRAKE_TEST = 1 << 30
    KEEP = 1 << 31
    """Grip and position are kept when power is lost (GPE); models with a brake only."""


class State(IntFlag):
    """The status double word."""

    READY = 1 << 0
    FIELDBUS = 1 << 1
    SHUTDOWN = 1 << 2
    NOT_FEASIBLE = 1 << 3
    SUCCESS = 1 << 4
    TOGGLE = 1 << 5
    """Inverted by each command that is taken."""
    WARNING = 1 << 6
    ERROR = 1 << 7
    MANUAL = 1 << 8
    SOFT_LIMIT = 1 << 9
    NO_PART = 1 << 11
    GRIPPED = 1 << 12
    POSITION = 1 << 13
    PRE_GRIP = 1 << 14
    LOST = 1 << 16
    WRONG_PART = 1 << 17
    KEEPS = 1 << 31


@dataclass(frozen=True, slots=True)
class Command:
    """What is written.

    Attributes:
        bits: what is to be done; RUN is added, but for a fast stop.
        position, speed: in m and m/s.
        force: in percent of the greatest.
    """

    bits: Control
    position: float = 0.0
    speed: float = 0.0
    force: int = 0

    def image(self, order: Order) -> bytes:
        """Return its bytes."""
        micro = round(self.position / MICRO), round(self.speed / MICRO)
        return struct.pack(f"{order}Iiii", self.bits, *micro, self.force)


IDLE: Final = Command(Control.RUN)
"""Between two commands: nothing is asked for, and nothing stopped."""


@dataclass(frozen=True, slots=True)
class Status:
    """What is read.

    Attributes:
        bits: see `State`; bits that have no meaning are dropped.
        position: in m.
        error, warning, additional: codes; see `crtk_driver_schunk.gripper.faults`.
    """

    bits: State
    position: float
    error: int
    warning: int
    additional: int

    @classmethod
    def parse(cls, image: bytes, order: Order) -> Status:
        """Return what 16 bytes say.

        Raises:
            ValueError: they are not 16.
        """
        if len(image) != SIZE:
            raise ValueError(f"{len(image)} bytes as status, not {SIZE}")
        bits, position, _, codes = struct.unpack(f"{order}IiII", image)
        known = State(bits & _KNOWN)
        return cls(known, position * MICRO, codes & 0xFF, codes >> 16 & 0xFF, codes >> 24)


_KNOWN: Final = sum(State)
