"""The binary protocol: bytes to messages and back. Pure: no I/O.

Source: WSG Command Set Reference Manual 4.0.x, 1.2 (frames, CRC), 3 (commands).
"""

from __future__ import annotations

import struct
from typing import Final

from crtk_driver_weiss_wsg.tables import COMMANDS, Command, Message, Status

__all__ = ["BinaryCodec", "crc", "frame"]

PREAMBLE: Final = b"\xaa\xaa\xaa"
HEAD: Final = 6
LONGEST: Final = 64
"""Bytes of payload in the longest reply that is asked for, with room."""


def _entry(index: int) -> int:
    value = index << 8
    for _ in range(8):
        value = value << 1 ^ (0x1021 if value & 0x8000 else 0)
    return value & 0xFFFF


_TABLE: Final = tuple(map(_entry, range(256)))


def crc(data: bytes) -> int:
    """Return the CRC: the table of polynomial 0x1021, high bit first, but shifted to the right.

    It is in no catalogue. Over a whole frame, its own bytes included, it is 0.
    """
    value = 0xFFFF
    for byte in data:
        value = _TABLE[(value ^ byte) & 0xFF] ^ value >> 8
    return value


def frame(number: int, payload: bytes = b"") -> bytes:
    """Return a frame: preamble, number, size and payload, CRC."""
    data = PREAMBLE + struct.pack("<BH", number, len(payload)) + payload
    return data + crc(data).to_bytes(2, "little")


class BinaryCodec:
    """One connection.

    Attributes:
        strange: bytes that were no frame, and frames that nobody knows.
    """

    def __init__(self) -> None:
        self.strange = 0
        self._rest = b""

    def encode(self, command: Command, *values: float) -> bytes:
        """Return the frame of a command with values in SI units; those that it does not take are left out."""
        form, scales, fixed, *_ = COMMANDS[command]
        scaled = (
            scale * value if code == "f" else round(scale * value)
            for code, scale, value in zip(form, scales, values, strict=False)
        )
        return frame(command, fixed + struct.pack("<" + form, *scaled))

    def subscribe(self, period: float) -> bytes:
        """Return what asks for its limits, once, and for all else every `period` seconds, the width last."""
        updates = (Command.SYSTEM, Command.GRASPING, Command.SPEED, Command.FORCE, Command.WIDTH)
        return self.encode(Command.LIMITS) + b"".join(self.encode(x, 1, period) for x in updates)

    def ask(self) -> bytes:
        """Return what must be asked for again and again: nothing."""
        return b""

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that bytes complete; what is damaged is left out, and counted."""
        rest = self._rest + data
        found: list[Message] = []
        while True:
            begin = rest.find(PREAMBLE)
            begin = max(0, len(rest) - 2) if begin < 0 else begin
            self.strange += begin
            rest = rest[begin:]
            if len(rest) < HEAD:
                break
            size = HEAD + int.from_bytes(rest[4:HEAD], "little") + 2
            if size <= HEAD + LONGEST + 2 and len(rest) < size:
                break
            if size > HEAD + LONGEST + 2 or crc(rest[:size]):
                self.strange += 1
                rest = rest[1:]
                continue
            message = _parse(rest[3], rest[HEAD : size - 2])
            self.strange += size if message is None else 0
            found += [] if message is None else [message]
            rest = rest[size:]
        self._rest = rest
        return found


def _parse(number: int, payload: bytes) -> Message | None:
    """Return the message of a frame; None: of nothing that was asked for."""
    try:
        command = Command(number)
        layout = COMMANDS[command]
        status = int.from_bytes(payload[:2], "little")
        if status != Status.OK or not layout.reply:
            return Message(command, status) if len(payload) >= 2 else None
        values = struct.unpack("<" + layout.reply, payload[2:])
    except (ValueError, struct.error):
        return None
    scaled = zip(values, layout.reply_scales, strict=True)
    return Message(command, status, tuple(value / scale for value, scale in scaled))
