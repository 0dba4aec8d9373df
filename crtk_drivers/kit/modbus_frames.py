"""Modbus from the side of a master, in both framings: values in, bytes out, and back. No I/O.

Sources: MODBUS Application Protocol 1.1b3, 6.3, 6.12, 6.17 and 7; MODBUS over Serial Line 1.02, 2.5 and
6.2.2; MODBUS Messaging on TCP/IP 1.0b, 3.1.3.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import ClassVar, Final, NamedTuple, Protocol

from crtk_drivers.kit.crc16 import reflected_crc16

__all__ = [
    "EXCEPTIONS",
    "READ",
    "READ_INPUT",
    "WRITE",
    "Exceptional",
    "Framing",
    "Mbap",
    "Question",
    "Rtu",
    "crc",
    "read",
    "read_write",
    "write",
]

READ: Final = 3
READ_INPUT: Final = 4
WRITE: Final = 16
_READ_WRITE: Final = 23
_LAST: Final = 0xFFFF


class Exceptional(NamedTuple):
    """An exception as answer.

    Attributes:
        text: its name.
        remedy: what to do; empty: it is another device than it should be.
        passes: the same question may be answered the next time.
    """

    text: str
    remedy: str
    passes: bool


EXCEPTIONS: Mapping[int, Exceptional] = MappingProxyType(
    {
        1: Exceptional("illegal function", "", passes=False),
        2: Exceptional("illegal data address", "", passes=False),
        3: Exceptional("illegal data value", "", passes=False),
        4: Exceptional("device failure", "Take its power away and give it back.", passes=True),
        5: Exceptional("acknowledged, takes longer", "Wait.", passes=True),
        6: Exceptional("busy", "Does another program talk to it?", passes=True),
        10: Exceptional(
            "no way from the gateway", "Check what the gateway is set to.", passes=True
        ),
        11: Exceptional(
            "nothing answers behind the gateway",
            "Is the device connected to it and powered, and is its address right?",
            passes=True,
        ),
    }
)
"""By code."""


class Question(NamedTuple):
    """A request (function and data), the beginning of its reply, and the reply's size."""

    request: bytes
    head: bytes
    size: int

    def is_answered_like(self, other: Question | None) -> bool:
        """Whether an answer to one could be an answer to the other."""
        return other is not None and (self.head, self.size) == (other.head, other.size)


def read(address: int, count: int, function: int = READ) -> Question:
    """Return the question for so many registers: `READ` holding ones, or `READ_INPUT`."""
    request = struct.pack(">BHH", function, address, count)
    return Question(request, bytes((function, 2 * count)), 2 + 2 * count)


def write(address: int, block: bytes) -> Question:
    """Return the question that writes the bytes of registers, high byte first."""
    head = struct.pack(">BHH", WRITE, address, len(block) // 2)
    return Question(head + bytes((len(block),)) + block, head, len(head))


def read_write(address: int, count: int, at: int, block: bytes) -> Question:
    """Return the question that writes bytes from register `at` on, and then reads, in one exchange."""
    size = len(block)
    request = struct.pack(">BHHHHB", _READ_WRITE, address, count, at, size // 2, size)
    return Question(request + block, bytes((_READ_WRITE, 2 * count)), 2 + 2 * count)


class Framing(Protocol):
    """How requests and replies are framed. It remembers what was asked last."""

    numbered: ClassVar[bool]
    """Whether a reply tells to which request it belongs."""

    def begin(self) -> None:
        """A connection begins: what was left of the one before belongs to nothing any more."""

    def ask(self, question: Question) -> bytes:
        """Return the frame to send; what came before is forgotten."""

    def aside(self, question: Question, unit: int | None = None) -> bytes:
        """Return a frame whose answer nobody waits for; what was asked last goes on being waited for.

        Args:
            question: that is asked.
            unit: another one than the device.
        """

    def feed(self, data: bytes) -> bytes | None:
        """Take bytes as they come; return the reply (function and data) once it is whole."""

    @property
    def strange(self) -> int:
        """How many bytes came that belong to no answer to what was asked."""


def crc(data: bytes) -> bytes:
    """Return the CRC-16 of Modbus as it is sent, low byte first."""
    return reflected_crc16(data, 0xFFFF).to_bytes(2, "little")


@dataclass
class Rtu:
    """Frames of a serial line: unit, function, data, CRC.

    Nothing in them says where one begins or to whom it belongs. An answer is what has the unit, the head and
    the size of the answer to the last question, and its CRC; all else (noise, what others on the line ask and
    are told) is left out.

    Args:
        unit: of the device.
    """

    unit: int
    strange: int = 0
    numbered: ClassVar[bool] = False
    _question: Question = field(default=Question(b"", b"", 0))
    _rest: bytes = b""

    def begin(self) -> None:
        """See `Framing`."""
        self.strange += len(self._rest)
        self._rest = b""

    def ask(self, question: Question) -> bytes:
        """See `Framing`."""
        self.begin()
        self._question = question
        return self.aside(question)

    def aside(self, question: Question, unit: int | None = None) -> bytes:
        """See `Framing`."""
        body = bytes((unit or self.unit,)) + question.request
        return body + crc(body)

    def feed(self, data: bytes) -> bytes | None:
        """See `Framing`."""
        if not self._question.request:  # nothing was asked yet
            self.strange += len(data)
            return None
        self._rest += data
        unit, (request, head, size) = bytes((self.unit,)), self._question
        candidates = (
            (unit + head, 1 + size + 2),
            (unit + bytes((request[0] | 0x80,)), 5),
        )
        keep = len(self._rest)
        for at in range(len(self._rest)):
            for begin, length in candidates:
                frame = self._rest[at : at + length]
                if frame[: len(begin)] != begin[: len(frame)]:
                    continue
                if len(frame) < length:
                    keep = min(keep, at)
                elif crc(frame[:-2]) == frame[-2:]:
                    self.strange += at
                    self._rest = self._rest[at + length :]
                    return frame[1:-2]
        self.strange += keep
        self._rest = self._rest[keep:]
        return None


@dataclass
class Mbap:
    """Frames of Modbus TCP: transaction, protocol 0, size, unit, function, data.

    Args:
        unit: of the device.
    """

    unit: int
    strange: int = 0
    numbered: ClassVar[bool] = True
    _transaction: int = 0
    _rest: bytes = b""

    def begin(self) -> None:
        """See `Framing`."""
        self.strange += len(self._rest)
        self._rest = b""

    def ask(self, question: Question) -> bytes:
        """See `Framing`; answers to earlier questions are told by their transaction."""
        self._transaction = self._transaction % _LAST + 1
        return self._frame(self._transaction, question, self.unit)

    def aside(self, question: Question, unit: int | None = None) -> bytes:
        """See `Framing`; its transaction is 0, which none of the others has."""
        return self._frame(0, question, unit or self.unit)

    @staticmethod
    def _frame(transaction: int, question: Question, unit: int) -> bytes:
        size = 1 + len(question.request)
        return struct.pack(">HHHB", transaction, 0, size, unit) + question.request

    def feed(self, data: bytes) -> bytes | None:
        """See `Framing`.

        Raises:
            ValueError: this is not Modbus TCP.
        """
        self._rest += data
        while len(self._rest) >= 8:
            transaction, protocol, size = struct.unpack_from(">HHH", self._rest)
            if protocol or not 2 <= size <= 254:
                raise ValueError(f"{self._rest[:20].hex(' ')} is not Modbus TCP")
            if len(self._rest) < 6 + size:
                break
            frame, self._rest = self._rest[: 6 + size], self._rest[6 + size :]
            if transaction == self._transaction and frame[6] == self.unit:
                return frame[7:]
            self.strange += len(frame)
        return None
