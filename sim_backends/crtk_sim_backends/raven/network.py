"""The network layer of the simulated Raven: which packets are used, as raven2's network_layer.cpp has it.

It does not look at the checksum, and sends nothing.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

PACKET: Final = struct.Struct("<III ii ii ii dd dd dd dd ii ii i i")
BEHIND: Final = 1000


@dataclass(frozen=True, slots=True)
class Packet:
    """What a packet says: of each of the two arms increments in µm, a quaternion x, y, z, w, and mrad."""

    number: int
    moves: tuple[tuple[int, int, int], ...]
    turns: tuple[tuple[float, float, float, float], ...]
    grasps: tuple[int, int]
    engaged: bool


class Network:
    """Sorts packets.

    Attributes:
        number: of the newest one that it took note of.
        counts: of packets, by what became of them.
    """

    def __init__(self) -> None:
        self.number = 0
        self.counts = dict.fromkeys(
            (
                "used",
                "skipped",
                "repeated",
                "reset",
                "out_of_sequence",
                "zero",
                "wrong_size",
                "wrong_checksum",
            ),
            0,
        )

    def take(self, data: bytes) -> Packet | None:
        """Return the packet if it is used."""
        if len(data) != PACKET.size:
            self.counts["wrong_size"] += 1
            return None
        values = PACKET.unpack(data)
        number, moves, turns, grasps = values[0], values[3:9], values[9:17], values[19:21]
        if (
            values[22] & 0xFFFFFFFF
            != (sum(moves) + sum(values[17:19]) + values[21] + number) % 2**32
        ):
            self.counts["wrong_checksum"] += 1  # and is used all the same
        fate = self._fate(number)
        self.counts[fate] += 1
        if fate != "used":
            return None
        return Packet(
            number,
            (moves[0::2], moves[1::2]),
            (turns[0::2], turns[1::2]),
            grasps,
            values[21] != 0,
        )

    def _fate(self, number: int) -> str:
        """Say what becomes of a packet with a number, and take note of that."""
        before = self.number
        if number == 0:
            return "zero"
        if number > before + 1:
            self.number = number
            return "skipped"
        if number == before:
            return "repeated"
        if number > before:
            self.number = number
            return "used"
        if before > BEHIND and number < before - BEHIND:
            self.number = number
            return "reset"
        return "out_of_sequence"
