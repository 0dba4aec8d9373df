"""Packets of IEEE 1394 in datagrams, as boards take and send them (EthernetIO.v of mechatronics-firmware)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

QUADLET_WRITE, BLOCK_WRITE, QUADLET_READ, BLOCK_READ = 0, 1, 4, 5
_QUADLET_RESPONSE, _BLOCK_RESPONSE = 6, 7

EVERYBODY: Final = 63
NO_FORWARD: Final = 0x01
DROPPED: Final = 0x02

_REQUEST: Final = struct.Struct(">HHHHI")


def _table() -> tuple[int, ...]:
    found = []
    for byte in range(256):
        value = byte << 24
        for _ in range(8):
            value = (value << 1 ^ (0x04C11DB7 if value & 0x80000000 else 0)) & 0xFFFFFFFF
        found.append(value)
    return tuple(found)


_TABLE: Final = _table()


def checksum(data: bytes) -> bytes:
    """Return the CRC of some bytes, most significant bit first."""
    value = 0xFFFFFFFF
    for byte in data:
        value = (value << 8 & 0xFFFFFFFF) ^ _TABLE[value >> 24 ^ byte]
    return (value ^ 0xFFFFFFFF).to_bytes(4)


class Request(NamedTuple):
    """What a client asks for.

    Attributes:
        forward: it may go over FireWire.
        generation: of the bus, as the client knows it.
        node: that is meant.
        label, source: for the answer.
        code: of the transaction.
        address: first register, or offset.
        size: quadlets of a block that is read.
        data: quadlets that are written.
    """

    forward: bool
    generation: int
    node: int
    label: int
    source: int
    code: int
    address: int
    size: int
    data: tuple[int, ...]


def request(data: bytes) -> Request | None:
    """Return what a datagram asks for; None if it is damaged, or nothing that a board knows."""
    control, packet = data[:2], data[2:]
    if len(packet) < 16:
        return None
    destination, labels, source, high, address = _REQUEST.unpack_from(packet)
    code = labels >> 4 & 0x0F
    body = packet[12:]
    size, written = 0, b""
    if code == QUADLET_READ:
        is_whole = _ends(packet, 16)
    elif code == QUADLET_WRITE:
        is_whole, written = _ends(packet, 20), body[:4]
    elif code == BLOCK_READ:
        is_whole, size = _ends(packet, 20), int.from_bytes(body[:2]) // 4
    elif code == BLOCK_WRITE:
        length = int.from_bytes(body[:2])
        written = packet[20 : 20 + length]
        has_header = len(packet) > 20 and packet[16:20] == checksum(packet[:16])
        is_whole = has_header and len(packet) == 24 + length and packet[-4:] == checksum(written)
    else:
        return None
    if not is_whole or high or destination >> 6 != 0x3FF:
        return None
    quadlets = struct.unpack(f">{len(written) // 4}I", written[: len(written) // 4 * 4])
    forward = not control[0] & NO_FORWARD
    return Request(
        forward, control[1], destination & 0x3F, labels >> 10, source, code, address, size, quadlets
    )


def _ends(packet: bytes, length: int) -> bool:
    return len(packet) == length and packet[-4:] == checksum(packet[:-4])


def answer(asked: Request, node: int, quadlets: Sequence[int], *, sealed: bool) -> bytes:
    """Return the packet of an answer.

    Args:
        asked: what was asked for.
        node: that answers.
        quadlets: of it.
        sealed: it comes by FireWire, and has its CRCs; those of the board with the cable are 0.
    """
    is_block = asked.code == BLOCK_READ
    code = _BLOCK_RESPONSE if is_block else _QUADLET_RESPONSE
    head = _REQUEST.pack(asked.source, asked.label << 10 | code << 4, 0xFFC0 | node, 0, 0)
    data = struct.pack(f">{len(quadlets)}I", *quadlets)
    if not is_block:
        return head + data + (checksum(head + data) if sealed else bytes(4))
    head += struct.pack(">HH", len(data), 0)
    if not sealed:
        return head + bytes(4) + data + bytes(4)
    return head + checksum(head) + data + checksum(data)


def extra(flags: int, generation: int, errors: int) -> bytes:
    """Return the eight bytes that the board with the cable adds: flags, generation, counters, times."""
    return struct.pack(">BBBBHH", flags, generation & 0xFF, 0, errors & 0xFF, 900, 2400)
