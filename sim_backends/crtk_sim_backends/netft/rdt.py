"""RDT, the stream over UDP: requests in, records out. No sockets.

Requests are 8 bytes, or 14 with an address to send to; records have 36 bytes; everything is big-endian. (ATI
9620-05-NET FT and 9610-05-Ethernet Axia, chapters on the UDP interface.)
"""

from __future__ import annotations

import ipaddress
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_sim_backends.netft.sensor import Block, Clock

HEADER: Final = 0x1234
EXTENDED: Final = 0x8000

STOP: Final = 0x0000
CLEAR_LATCH: Final = 0x0041
BIAS: Final = 0x0042
BIAS_SET: Final = 255
"""Count of the bias command that sets it, where that says so."""

_RECORD: Final = np.dtype([("rdt", ">u4"), ("ft", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)])
_SIZE: Final = _RECORD.itemsize
_WRAP: Final = 2**32

Address = tuple[str, int]


@dataclass(frozen=True)
class Request:
    """One request; `to` is where the stream is to go instead of to the sender."""

    command: int
    count: int
    to: Address | None = None


def decode(data: bytes) -> Request | None:
    """Return the request of a datagram; None for anything else, which a box ignores."""
    if len(data) not in (8, 14):
        return None
    header, command, count = struct.unpack_from(">HHI", data)
    if header != HEADER or bool(command & EXTENDED) != (len(data) == 14):
        return None
    if len(data) == 8:
        return Request(command, count)
    address, port = struct.unpack_from(">4sH", data, 8)
    return Request(command & ~EXTENDED, count, (str(ipaddress.IPv4Address(address)), port))


class Stream:
    """What one request began: records to one address, until the next one takes its place.

    Args:
        to: address of the client.
        count: of records to send, 0 for no end.
        size: records in a datagram.
        first: number of the first measurement to send.
        divisor: measurements from one record to the next.
    """

    def __init__(self, to: Address, count: int, size: int, first: int, divisor: int) -> None:
        self.to = to
        self.size = size
        self.sequence = 1  # of the next record
        self.sent = 0  # records
        self._count = count
        self._divisor = divisor
        self._next = first
        self._block: Block | None = None
        self._records = memoryview(b"")
        self._place = 0
        self._waiting = b""  # records of a datagram that is not full

    @property
    def ended(self) -> bool:
        """Whether all records that were asked for have been sent."""
        return bool(self._count) and self.sent >= self._count

    def set_divisor(self, divisor: int) -> None:
        """Take another distance between records."""
        self._divisor = divisor
        self._block = None

    def jump(self, sequence: int) -> None:
        """Go on with another rdt_sequence."""
        self.sequence = sequence
        self._block = None

    def due(self, clock: Clock) -> float:
        """Return when the next datagram is due, monotonic s."""
        missing = self.size - len(self._waiting) // _SIZE
        if self._count:
            missing = min(missing, self._count - self.sent)
        return clock.time_of(self._next + (missing - 1) * self._divisor)

    def take(self, block: Block, end: int) -> list[bytes]:
        """Return the datagrams of a block that are complete with its measurements before the one `end`."""
        ready = self._ready(block, end)
        if ready <= 0:
            return []
        data = bytes(self._records[self._place : self._place + ready * _SIZE])
        self._advance(ready)
        return self._packed(self._waiting + data)

    def send_ahead(
        self, block: Block, clock: Clock, until: float, send: Callable[[memoryview], object]
    ) -> None:
        """Send the records of a block, one in a datagram, each when it is due, until a monotonic time."""
        ready = self._ready(block, block.end)  # of a new block, which begins at another place
        due, step = clock.time_of(self._next), self._divisor / clock.rate
        place, sent = self._place, 0
        for _ in range(ready):
            if due > until:
                break
            wait = due - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            send(self._records[place : place + _SIZE])
            due += step
            place += _SIZE
            sent += 1
        self._advance(sent)

    def _ready(self, block: Block, end: int) -> int:
        """Return how many records of a block there are before the measurement `end`."""
        if block is not self._block:
            self._encode(block)
        ready = (min(end, block.end) - self._next + self._divisor - 1) // self._divisor
        return max(0, min(ready, self._count - self.sent) if self._count else ready)

    def _advance(self, records: int) -> None:
        self._place += records * _SIZE
        self._next += records * self._divisor
        self.sequence = (self.sequence + records) % _WRAP
        self.sent += records

    def _packed(self, data: bytes) -> list[bytes]:
        length = self.size * _SIZE
        full = len(data) if self.ended else len(data) // length * length
        self._waiting = data[full:]
        return [data[start : min(start + length, full)] for start in range(0, full, length)]

    def _encode(self, block: Block) -> None:
        self._block, self._place = block, 0
        first = max(0, self._next - block.first)
        part = slice(first, None, self._divisor)
        records = np.empty(len(block.ft[part]), _RECORD)
        records["rdt"] = (np.arange(records.size) + self.sequence) % _WRAP
        records["ft"] = block.ft[part]
        records["status"] = block.status[part]
        records["counts"] = block.counts[part]
        self._records = memoryview(records.tobytes())
