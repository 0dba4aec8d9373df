"""Packets of DYNAMIXEL Protocol 1.0 and 2.0, as a servo sees them: bytes in, instructions out.

Sources: ROBOTIS e-manual, "DYNAMIXEL Protocol 1.0" and "DYNAMIXEL Protocol 2.0"
(https://emanual.robotis.com/docs/en/dxl/protocol2/).
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from typing_extensions import override

BROADCAST: Final = 0xFE
HEADER: Final = b"\xff\xff\xfd\x00"
STATUS: Final = 0x55
ALERT: Final = 0x80
"""Bit of the error byte (2.0): Hardware Error Status is not zero."""

_MARK: Final = HEADER[:3]
_STUFFED: Final = _MARK + b"\xfd"
_LONGEST: Final = 4096  # LEN of an instruction that a servo believes


class Code(IntEnum):
    """Instructions; those of protocol 1.0 have the same numbers where both have them."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    BACKUP = 0x20
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


class Error(IntEnum):
    """Error numbers of protocol 2.0, bits 0 to 6 of the error byte."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


LEGACY_ERROR: Final = {
    Error.RESULT_FAIL: 0x40,
    Error.INSTRUCTION: 0x40,
    Error.CRC: 0x10,
    Error.RANGE: 0x08,
    Error.LENGTH: 0x08,
    Error.LIMIT: 0x02,
    Error.ACCESS: 0x08,
}
"""The bit of the error byte of protocol 1.0 that comes nearest."""


@dataclass(frozen=True, slots=True)
class Instruction:
    """One instruction packet.

    Attributes:
        protocol: 1 or 2.
        id: of the servo, or BROADCAST.
        code: see `Code`; any other number too.
        parameters: without stuffing.
        intact: whether CRC or checksum are right.
        end: how many bytes the parser had taken when it was complete.
    """

    protocol: int
    id: int
    code: int
    parameters: bytes
    intact: bool
    end: int


def _make_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = crc << 1 ^ (0x8005 if crc & 0x8000 else 0)
        table.append(crc & 0xFFFF)
    return tuple(table)


_TABLE: Final = _make_table()


def crc16(data: bytes | bytearray, crc: int = 0) -> int:
    """CRC-16 with polynomial 0x8005, not reflected; `crc` is that of the bytes before `data`."""
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ _TABLE[crc >> 8 ^ byte]
    return crc


def checksum(data: bytes | bytearray) -> int:
    """Sum of protocol 1.0 over ID to the last parameter."""
    return ~sum(data) & 0xFF


def status(number: int, error: int, data: bytes = b"") -> bytes:
    """Status packet of protocol 2.0, with stuffing."""
    body = bytes((STATUS, error)) + data
    if _MARK in body:
        body = body.replace(_MARK, _STUFFED)
    packet = HEADER + struct.pack("<BH", number, len(body) + 2) + body
    return packet + struct.pack("<H", crc16(packet))


def fast_status(answers: Sequence[tuple[int, int, bytes]]) -> bytes:
    """The one status packet that all servos of a fast read write together.

    Args:
        answers: error, id and data of each servo. Every one ends its part with the CRC of all that was
            sent before, and nothing is stuffed (e-manual, Fast Sync Read).
    """
    length = 1 + sum(len(data) + 4 for _, _, data in answers)
    packet = bytearray(HEADER + struct.pack("<BHB", BROADCAST, length, STATUS))
    crc = crc16(packet)
    for error, number, data in answers:
        part = bytes((error, number)) + data
        crc = crc16(part, crc)
        packet += part
        ending = struct.pack("<H", crc)
        crc = crc16(ending, crc)
        packet += ending
    return bytes(packet)


def legacy_status(number: int, error: int, data: bytes = b"") -> bytes:
    """Status packet of protocol 1.0."""
    body = bytes((number, len(data) + 2, error)) + data
    return b"\xff\xff" + body + bytes((checksum(body),))


class Parser(ABC):
    """Finds the instructions in the bytes of a wire; `taken` of them so far."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.taken = 0

    def reset(self) -> None:
        """Forget an unfinished packet."""
        self._buffer.clear()

    def feed(self, data: bytes) -> list[Instruction]:
        """Take bytes, cut anywhere, and return the instructions that they complete."""
        self._buffer += data
        self.taken += len(data)
        found = []
        while (packet := self._next()) is not None:
            found.append(packet)
        return found

    @abstractmethod
    def _next(self) -> Instruction | None:
        """Take the next instruction out of what has come; None: it is not whole yet."""


class Parser2(Parser):
    """Of protocol 2.0. What is not stuffed and looks like a header begins a new packet."""

    @override
    def _next(self) -> Instruction | None:
        buffer = self._buffer
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                del buffer[: max(0, len(buffer) - len(HEADER) + 1)]
                return None
            del buffer[:start]
            if len(buffer) < 10:
                return None
            number, length, code = struct.unpack_from("<BHB", buffer, 4)
            if not 3 <= length <= _LONGEST:
                del buffer[:3]
                continue
            nested = _unstuffed(buffer, 7, min(len(buffer), length + 5))
            if nested is not None:
                del buffer[:nested]
                continue
            if len(buffer) < length + 7:
                return None
            body = bytes(buffer[8 : length + 5])
            intact = crc16(buffer[: length + 5]) == struct.unpack_from("<H", buffer, length + 5)[0]
            del buffer[: length + 7]
            body = body.replace(_STUFFED, _MARK)
            return Instruction(2, number, code, body, intact, self.taken - len(buffer))


def _unstuffed(buffer: bytearray, start: int, end: int) -> int | None:
    """Where in [start, end) a header mark stands that is not followed by the stuffing byte."""
    while (start := buffer.find(_MARK, start, end)) >= 0:
        if start + 3 < end and buffer[start + 3] != 0xFD:
            return start
        start += 3
    return None


class Parser1(Parser):
    """Of protocol 1.0."""

    @override
    def _next(self) -> Instruction | None:
        buffer = self._buffer
        while True:
            start = buffer.find(b"\xff\xff")
            if start < 0:
                del buffer[: max(0, len(buffer) - 1)]
                return None
            del buffer[:start]
            if len(buffer) < 4:
                return None
            number, length = buffer[2], buffer[3]
            if number in (0xFD, 0xFF) or length < 2:  # 2.0 has FD here, and its next byte is 0
                del buffer[0]
                continue
            if len(buffer) < length + 4:
                return None
            body = bytes(buffer[2 : length + 3])
            intact = checksum(body) == buffer[length + 3]
            del buffer[: length + 4]
            return Instruction(1, number, body[2], body[3:], intact, self.taken - len(buffer))
