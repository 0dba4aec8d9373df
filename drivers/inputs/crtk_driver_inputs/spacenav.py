"""The socket of spacenavd, for six-axis mice of 3Dconnexion. Bytes to events, and requests to bytes.

A stream of eight int32 in the machine's own order: kind, then data. Protocol 1 is asked for with four bytes,
and answered with four; an older daemon takes them for a sensitivity and answers nothing, so that it is given
back its own. Source: libspnav, src/proto.h and src/spnav.c (FreeSpacenav).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from crtk_drivers.kit import FrameDecoder

FRAME: Final = struct.Struct("@8i")
WORD: Final = struct.Struct("@i")
SOCKET: Final = "/var/run/spnav.sock"

_MOTION, _PRESS, _RELEASE, _DEVICE = range(4)
_TAG: Final = 0x7FAA0000
_CHANGE_PROTOCOL: Final = 0x5500
_GET_TYPE: Final = 0x2005
_ADDED: Final = 0
_AXES: Final = 6


@dataclass(frozen=True, slots=True)
class Motion:
    """Where the cap is pushed: x, y, z, and turned about them, in counts, in the daemon's axes."""

    counts: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Press:
    """A button is pressed, or is not any more."""

    code: int
    pressed: bool


@dataclass(frozen=True, slots=True)
class Mouse:
    """Whether there is one."""

    present: bool


Event = Motion | Press | Mouse | None

HELLO: Final = WORD.pack(_TAG | _CHANGE_PROTOCOL | 1)
"""Asks for protocol 1."""
SENSITIVITY: Final = struct.pack("@f", 1.0)
"""What an older daemon is given, that took the question for a sensitivity."""
ASK_FOR_MOUSE: Final = FRAME.pack(_TAG | _GET_TYPE, *(0,) * 7)
"""Asks of what type the mouse is; answered with a status below 0 if there is none."""


def agreed(told: bytes) -> tuple[int, bytes] | None:
    """Return the protocol that the daemon has agreed to, and the events around its answer.

    None while there is none: an older daemon never answers, and events may come before.
    """
    for at in range(0, len(told) - WORD.size + 1, FRAME.size):
        (word,) = WORD.unpack_from(told, at)
        if word & 0x7FFFFF00 == _TAG | _CHANGE_PROTOCOL:
            return int(word & 0xFF), told[:at] + told[at + WORD.size :]
    return None


def decoder() -> FrameDecoder[Event]:
    """Return what turns bytes into events; None is one that does not matter."""
    return FrameDecoder(lambda data: FRAME.size, _parsed, strict=True)


def _parsed(frame: bytes) -> Event:
    kind, *data = FRAME.unpack(frame)
    if kind == _MOTION:
        return Motion(tuple(data[:_AXES]))
    if kind in (_PRESS, _RELEASE):
        return Press(data[0], kind == _PRESS)
    if kind == _DEVICE:
        return Mouse(data[0] == _ADDED)
    if kind == _TAG | _GET_TYPE:
        return Mouse(data[6] >= 0)
    if kind & 0x7FFF0000 == _TAG or 0 <= kind < 7:
        return None
    raise ValueError(f"{kind} is no kind of event")
