"""Modbus for the one thing that is asked of it, in both framings: values in, bytes out, and back. No I/O.

Sources: MODBUS Application Protocol 1.1b3, 6.3, 6.12, 6.17 and 7; MODBUS over Serial Line 1.02, 2.5 and
6.2.2; MODBUS Messaging on TCP/IP 1.0b, 3.1.3.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from crtk_driver_robotiq.registers import COMMAND, SIZE, STATUS
from crtk_drivers.kit.crc16 import reflected_crc16

__all__ = [
    "EXCEPTIONS",
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

_COUNT: Final = SIZE // 2
WRITE: Final = 16
_READ_WRITE: Final = 23
_LAST: Final = 0xFFFF


class Exceptional(NamedTuple):
    """An exception as answer. `passes`: the same question may be answered the next time."""

    text: str
    remedy: str
    passes: bool


_OTHER = (
    "Is it a gripper with these registers (2F-85, 2F-140, Hand-E), and no ePick or force sensor?"
)
EXCEPTIONS: Mapping[int, Exceptional] = MappingProxyType(
    {
        1: Exceptional("illegal function", _OTHER, passes=False),
        2: Exceptional("illegal data address", _OTHER, passes=False),
        3: Exceptional("illegal data value", _OTHER, passes=False),
        4: Exceptional("device failure", "Take its power away and give it back.", passes=True),
        5: Exceptional("acknowledged, takes longer", "Wait.", passes=True),
        6: Exceptional("busy", "Does another program talk to it?", passes=True),
    }
)
"""By code."""


class Question(NamedTuple):
    """A request (function and data), the beginning of its reply, and the reply's size."""

    request: bytes
    head: bytes
    size: int


def read(function: int) -> Question:
    """Return the question for the status; function 3 and 4 have the same answer."""
    request = struct.pack(">BHH", function, STATUS, _COUNT)
    return Question(request, bytes((function, SIZE)), 2 + SIZE)


def write(block: bytes) -> Question:
    """Return the question that writes the command."""
    head = struct.pack(">BHH", WRITE, COMMAND, _COUNT)
    return Question(head + bytes((SIZE,)) + block, head, len(head))


def read_write(block: bytes) -> Question:
    """Return the question that writes the command and then reads the status, in one exchange."""
    request = struct.pack(">BHHHHB", _READ_WRITE, STATUS, _COUNT, COMMAND, _COUNT, SIZE)
    return Question(request + block, bytes((_READ_WRITE, SIZE)), 2 + SIZE)


class Framing(Protocol):
    """How requests and replies are framed. It remembers what was asked last."""

    def ask(self, question: Question) -> bytes:
        """Return the frame to send; what came before is forgotten."""

    def aside(self, question: Question) -> bytes:
        """Return a frame whose answer nobody waits for; what was asked last goes on being waited for."""

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
        unit: of the gripper.
    """

    unit: int
    strange: int = 0
    _question: Question = field(default=Question(b"", b"", 0))
    _rest: bytes = b""

    def ask(self, question: Question) -> bytes:
        """See `Framing`."""
        self.strange += len(self._rest)
        self._rest, self._question = b"", question
        return self.aside(question)

    def aside(self, question: Question) -> bytes:
        """See `Framing`."""
        body = bytes((self.unit,)) + question.request
        return body + crc(body)

    def feed(self, data: bytes) -> bytes | None:
        """See `Framing`."""
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
        unit: of the gripper.
    """

    unit: int
    strange: int = 0
    _transaction: int = 0
    _rest: bytes = b""

    def ask(self, question: Question) -> bytes:
        """See `Framing`; answers to earlier questions are told by their transaction."""
        self._transaction = self._transaction % _LAST + 1
        return self._frame(self._transaction, question)

    def aside(self, question: Question) -> bytes:
        """See `Framing`; its transaction is 0, which none of the others has."""
        return self._frame(0, question)

    def _frame(self, transaction: int, question: Question) -> bytes:
        size = 1 + len(question.request)
        return struct.pack(">HHHB", transaction, 0, size, self.unit) + question.request

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
