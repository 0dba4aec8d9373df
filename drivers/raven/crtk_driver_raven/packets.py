"""Packets of the interoperable teleoperation protocol as Raven II takes them. Pure: no I/O.

Sources: itp_teleoperation.h (u_struct) and network_layer.cpp (UDPChecksum, the rules for numbers) of raven2,
University of Washington. Nothing comes back: the struct for that is declared, and never sent.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

__all__ = ["FIRST", "NOTHING", "PRIMING", "SIZE", "Increment", "after", "encode"]

_PACKET: Final = struct.Struct("<3I6i8d4i2i")
SIZE: Final = _PACKET.size
_INT: Final = 1 << 32

WINDOW: Final = 1000
"""Numbers behind the newest one within which Raven drops what comes; further behind, it begins anew."""
FIRST: Final = 1 << 16
"""No session begins below it: Raven begins anew only where its own number is above `WINDOW`."""
PRIMING: Final = 2 * WINDOW + 1
"""From the first packet to the second, after which Raven expects the number that follows, whatever it had:
the first is ahead of that, or far behind it, so that Raven begins anew; if neither, the second is ahead."""


@dataclass(frozen=True, slots=True)
class Increment:
    """What one arm is to do in one packet.

    Attributes:
        position: in whole µm, along the axes of the protocol.
        rotation: unit quaternion (x, y, z, w), about the axes of the protocol at the tool.
        closing: of the jaw, in whole mrad.
    """

    position: tuple[int, int, int] = (0, 0, 0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    closing: int = 0


NOTHING: Final = Increment()


def encode(number: int, arms: Sequence[Increment], *, engaged: bool) -> bytes:
    """Return the packet with a number, of the gold (left) arm and the green (right) one.

    Args:
        number: one more than that of the packet before; not 0, which Raven only logs.
        arms: both of them.
        engaged: the pedal is down.
    """
    gold, green = arms
    moves = [value for pair in zip(gold.position, green.position, strict=True) for value in pair]
    turns = [value for pair in zip(gold.rotation, green.rotation, strict=True) for value in pair]
    buttons = (0, 0)
    total = int(engaged) + sum(moves) + sum(buttons) + number
    checksum = (total + _INT // 2) % _INT - _INT // 2
    return _PACKET.pack(
        number, 0, 0, *moves, *turns, *buttons, gold.closing, green.closing, engaged, checksum
    )


def after(number: int, steps: int = 1) -> int:
    """Return the number so many packets later; past the last one it begins anew at `FIRST`."""
    following = number + steps
    return following if following < _INT else FIRST
