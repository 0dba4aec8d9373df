"""FireWire packets over UDP, as FPGA1394 boards take and send them: bytes in, values out; no I/O.

A request is two bytes for the board that has the Ethernet cable, and a packet of IEEE 1394; a reply is
such a packet and eight bytes of that board. Big-endian throughout.

Source: JHU mechatronics-software, ``lib/code/EthBasePort.cpp`` (``make_*_packet``, ``ProcessExtraData``),
and mechatronics-firmware, ``EthernetIO.v``. A board leaves the CRC of its own replies at 0; those that it
forwards from other boards have one.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

PORT: Final = 1394
"""UDP port of a board."""

BROADCAST: Final = 63
"""Node that all boards are; with `NO_FORWARD` it is the board with the Ethernet cable, whichever that is."""

NO_FORWARD: Final = 0x01
"""Flag of a request: it is for the board with the cable, and not sent on by FireWire."""

LABELS: Final = 64
"""Transaction labels, by which a reply tells which request it answers."""

EXTRA: Final = 8
"""Bytes that the board with the cable adds; alone they are what it says in place of an answer."""

DROPPED: Final = 0x02
"""Flag in these bytes: the request was dropped, since it was of another generation of the bus."""


class Tcode(IntEnum):
    """Transaction codes."""

    QUADLET_WRITE = 0
    BLOCK_WRITE = 1
    QUADLET_READ = 4
    BLOCK_READ = 5
    QUADLET_RESPONSE = 6
    BLOCK_RESPONSE = 7


_SOURCE: Final = 0xFFD0
"""Node that requests say they come from: 16, none of the boards."""

_BUS: Final = 0xFFC0
_HEADER: Final = struct.Struct(">HHHHI")
_QUADLET: Final = struct.Struct(">I")
_QUADLET_RESPONSE: Final = 20
_BLOCK_HEADER: Final = 20
_REVERSED: Final = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc(data: bytes) -> int:
    """Return the CRC of IEEE 1394: polynomial 0x04C11DB7, most significant bit first (CRC-32/BZIP2)."""
    return int(f"{zlib.crc32(data.translate(_REVERSED)):032b}"[::-1], 2)


def _sealed(data: bytes) -> bytes:
    return data + _QUADLET.pack(crc(data))


def _header(node: int, label: int, tcode: Tcode, address: int) -> bytes:
    return _HEADER.pack(_BUS | node, label << 10 | tcode << 4, _SOURCE, 0, address)


def read_quadlet(node: int, address: int, label: int) -> bytes:
    """Return the packet that asks a node for one register."""
    return _sealed(_header(node, label, Tcode.QUADLET_READ, address))


def write_quadlet(node: int, address: int, value: int, label: int) -> bytes:
    """Return the packet that writes one register of a node."""
    return _sealed(_header(node, label, Tcode.QUADLET_WRITE, address) + _QUADLET.pack(value))


def read_block(node: int, address: int, quadlets: int, label: int) -> bytes:
    """Return the packet that asks a node for several quadlets."""
    size = _QUADLET.pack(4 * quadlets << 16)
    return _sealed(_header(node, label, Tcode.BLOCK_READ, address) + size)


def write_block(node: int, address: int, values: Sequence[int], label: int) -> bytes:
    """Return the packet that writes several quadlets of a node."""
    size = _QUADLET.pack(4 * len(values) << 16)
    data = struct.pack(f">{len(values)}I", *values)
    return _sealed(_header(node, label, Tcode.BLOCK_WRITE, address) + size) + _sealed(data)


def datagram(packet: bytes, generation: int, *, forward: bool) -> bytes:
    """Return the datagram of a packet.

    Args:
        packet: for the bus.
        generation: of the FireWire bus, as the board told it last; packets of another one are dropped.
        forward: it may be sent on by FireWire.
    """
    return bytes((0 if forward else NO_FORWARD, generation & 0xFF)) + packet


@dataclass(frozen=True, slots=True)
class Extra:
    """What the board with the cable adds to a reply.

    Attributes:
        flags: see `DROPPED`.
        generation: of the FireWire bus: another one after each bus reset.
    """

    flags: int
    generation: int


@dataclass(frozen=True, slots=True)
class Reply:
    """An answer to a read.

    Attributes:
        node: that answers.
        label: of the request.
        quadlets: that were asked for.
        extra: of the board with the cable.
    """

    node: int
    label: int
    quadlets: tuple[int, ...]
    extra: Extra


def parse(data: bytes) -> Reply | Extra:
    """Return what a datagram from a board says: a reply, or its own eight bytes alone.

    Raises:
        ValueError: it is neither, with what does not fit.
    """
    if len(data) < EXTRA:
        raise ValueError(f"{len(data)} bytes are no reply")
    packet, extra = data[:-EXTRA], Extra(data[-EXTRA], data[-EXTRA + 1])
    if not packet:
        return extra
    if len(packet) < _QUADLET_RESPONSE:
        raise ValueError(f"{len(data)} bytes are no reply")
    _, labels, source, rcode, _ = _HEADER.unpack_from(packet)
    tcode = labels >> 4 & 0x0F
    if tcode == Tcode.QUADLET_RESPONSE:
        quadlets = _quadlet_of(packet)
    elif tcode == Tcode.BLOCK_RESPONSE:
        quadlets = _block_of(packet)
    else:
        raise ValueError(f"transaction code {tcode} is no response")
    if rcode >> 12:
        raise ValueError(f"the node refuses, with response code {rcode >> 12}")
    return Reply(source & 0x3F, labels >> 10, quadlets, extra)


def _quadlet_of(packet: bytes) -> tuple[int, ...]:
    if len(packet) != _QUADLET_RESPONSE:
        raise ValueError(f"a quadlet comes in {len(packet)} bytes, not {_QUADLET_RESPONSE}")
    _check(packet, 0, 16)
    return (_QUADLET.unpack_from(packet, 12)[0],)


def _block_of(packet: bytes) -> tuple[int, ...]:
    size = int.from_bytes(packet[12:14])
    if size % 4 or len(packet) != _BLOCK_HEADER + size + 4:
        raise ValueError(f"a block of {size} bytes comes in {len(packet)}")
    _check(packet, 0, 16)
    _check(packet, _BLOCK_HEADER, _BLOCK_HEADER + size)
    return struct.unpack_from(f">{size // 4}I", packet, _BLOCK_HEADER)


def _check(packet: bytes, begin: int, end: int) -> None:
    """Compare the CRC after some bytes; 0 is none."""
    told = _QUADLET.unpack_from(packet, end)[0]
    if told and told != crc(packet[begin:end]):
        raise ValueError(f"CRC {told:08x} is not that of its bytes")
