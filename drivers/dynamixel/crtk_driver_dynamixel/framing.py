"""From bytes as they arrive to status packets: what both protocols have in common. No I/O, no clock."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple


class Status(NamedTuple):
    """A status packet.

    Attributes:
        id: of the servo.
        error: what was wrong with the request, see `error_text` of the protocol; 0 if nothing was.
        alert: whether the servo has a hardware error.
        params: data, unstuffed.
        hardware: bits of the hardware error if they came with the status: protocol 1.0 only.
    """

    id: int
    error: int
    alert: bool
    params: bytes
    hardware: int = 0


class StatusParser(ABC):
    """Turns what arrives, however it is split, into status packets.

    Whatever is no valid packet is skipped, and the search for a header goes on right behind the header of the
    damaged one, so that a wrong length costs no packet that follows. An echo of our own request is
    recognised and counted.

    Args:
        longest: size in bytes of the longest packet that can be expected; what claims more is garbage.

    Attributes:
        bad_crc: packets whose CRC or checksum was wrong.
        corrupt: ids in those and in incomplete packets, which may be damaged too; for the caller to clear.
        garbage: bytes that belonged to no packet.
        echoes: instruction packets.
    """

    header: bytes
    head_size: int
    """Bytes up to and including the length."""
    header_skip: int
    """Bytes behind which the search goes on where a header belongs to no valid packet."""

    def __init__(self, longest: int) -> None:
        self.longest = longest
        self.bad_crc = 0
        self.corrupt: list[int] = []
        self.garbage = 0
        self.echoes = 0
        self._buffer = bytearray()
        self._request = b""

    def feed(self, data: bytes) -> list[Status]:
        """Take bytes and return the status packets that are complete now."""
        self._buffer += data
        return self._parse(final=False)

    def finish(self) -> list[Status]:
        """Give up waiting for more, and return what was held back or lay behind an incomplete packet."""
        return self._parse(final=True)

    def expect_echo(self, request: bytes) -> None:
        """Be told what was sent: in protocol 1.0 an echo is told from a status only by its bytes."""
        self._request = request

    @property
    def pending(self) -> int:
        """Bytes of what may become a packet."""
        return len(self._buffer)

    @abstractmethod
    def _size(self, buffer: bytearray) -> int:
        """Return the size of the packet at the start; more than there is if unknown, 0 if impossible."""

    @abstractmethod
    def _id(self, packet: bytes | bytearray) -> int:
        """Return the id that a packet carries, of which the head is there at least."""

    @abstractmethod
    def _is_valid(self, packet: bytes) -> bool:
        """Return whether the CRC or checksum is right."""

    @abstractmethod
    def _status(self, packet: bytes, *, last: bool) -> Status | None:
        """Return what a valid packet says, None if it is an echo; `last`: nothing follows it."""

    def _waits(self, packet: bytes) -> bool:
        """Return whether a valid packet, behind which there is nothing, is told from an echo only later."""
        return False

    def _skip(self, count: int) -> None:
        self.garbage += count
        del self._buffer[:count]

    def _parse(self, *, final: bool) -> list[Status]:
        buffer = self._buffer
        found: list[Status] = []
        while True:
            start = buffer.find(self.header)
            if start < 0:
                self._skip(len(buffer) - (0 if final else self._begun()))
                return found
            if start:
                self._skip(start)
            size = self._size(buffer)
            if size > len(buffer) and not final:
                return found
            if not 0 < size <= len(buffer):
                if len(buffer) >= self.head_size and size:
                    self.corrupt.append(self._id(buffer))
                self._skip(self.header_skip)
                continue
            packet = bytes(buffer[:size])
            if not self._is_valid(packet):
                self.bad_crc += 1
                self.corrupt.append(self._id(packet))
                self._skip(self.header_skip)
                continue
            last = size == len(buffer)
            if last and not final and self._waits(packet):
                return found
            del buffer[:size]
            status = self._status(packet, last=last)
            if status is None:
                self.echoes += 1
            else:
                found.append(status)

    def _begun(self) -> int:
        """Return how many bytes at the end may be the start of a header."""
        sizes = range(len(self.header) - 1, 0, -1)
        return next((n for n in sizes if self._buffer.endswith(self.header[:n])), 0)
