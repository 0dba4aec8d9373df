"""Captures of RDT traffic: pcap and pcapng in, datagrams out. Pure; the bytes come from the caller.

Formats: draft-ietf-opsawg-pcap (pcap), draft-ietf-opsawg-pcapng, and the list of link types of tcpdump.org.
Of each packet only an IPv4 datagram of UDP is looked at, unless it is a fragment. What was captured to its
snapshot length only does not count as a datagram.
"""

from __future__ import annotations

import ipaddress
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

LONGEST_PACKET: Final = 1 << 18
"""Bytes of a captured packet at most, as tcpdump has it."""
MOST_INTERFACES: Final = 1024
"""In a section of a pcapng."""

PCAPNG_MAGIC: Final = b"\x0a\x0d\x0d\x0a"
_PCAP_MAGICS: Final[Mapping[bytes, tuple[str, float]]] = {
    b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6),
    b"\xa1\xb2\x3c\x4d": (">", 1e-9),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9),
}
"""Byte order and unit of the second half of a time, by the first bytes of a file."""

_IPV4: Final = 0x0800
_VLAN_TAGS: Final = (0x8100, 0x88A8, 0x9100)
_UDP: Final = 17


def is_capture(content: bytes) -> bool:
    """Whether a file begins as a capture does."""
    return content[:4] == PCAPNG_MAGIC or content[:4] in _PCAP_MAGICS


class CaptureError(ValueError):
    """A capture that cannot be read; says at which offset, in bytes."""


class Packet(NamedTuple):
    """One captured packet: when, in s since the epoch; its link type; its bytes; where it is in the file."""

    time: float
    link: int
    data: bytes
    offset: int


class Datagram(NamedTuple):
    """A UDP datagram over IPv4; `time` in s since the epoch, `offset` of its packet in the file."""

    time: float
    source: str
    source_port: int
    payload: bytes
    offset: int


@dataclass
class Capture:
    """The datagrams of a file, to be iterated over once.

    Attributes:
        content: the file.
        cut: whether it ends in the middle of a packet, known at the end.
    """

    content: bytes
    cut: bool = False

    def __iter__(self) -> Iterator[Datagram]:
        """Yield the datagrams.

        Raises:
            CaptureError: the file is damaged, or of a kind that is not known.
        """
        packets = self._pcapng if self.content[:4] == PCAPNG_MAGIC else self._pcap
        for packet in packets():
            if packet.link not in _LINKS:
                known = ", ".join(map(str, _LINKS))
                raise CaptureError(
                    f"offset {packet.offset}: link type {packet.link} is not known; known are {known}"
                )
            found = _udp(_LINKS[packet.link](packet.data))
            if found is not None:
                yield Datagram(packet.time, *found, packet.offset)

    def _pcap(self) -> Iterator[Packet]:
        content = self.content
        if content[:4] not in _PCAP_MAGICS or len(content) < 24:
            raise CaptureError("offset 0: no header of a pcap")
        order, unit = _PCAP_MAGICS[content[:4]]
        link = struct.unpack_from(f"{order}I", content, 20)[0] & 0xFFFF
        header = struct.Struct(f"{order}IIII")
        offset = 24
        while len(content) - offset >= header.size:
            seconds, part, length, whole = header.unpack_from(content, offset)
            if length > LONGEST_PACKET:
                raise CaptureError(f"offset {offset}: a packet of {length} bytes")
            begin = offset + header.size
            if begin + length > len(content):
                break
            if length == whole:
                data = content[begin : begin + length]
                yield Packet(seconds + part * unit, link, data, offset)
            offset = begin + length
        self.cut = offset < len(content)

    def _pcapng(self) -> Iterator[Packet]:
        content = self.content
        order, offset = "<", 0
        interfaces: list[_Interface] = []
        while len(content) - offset >= 12:
            if content[offset : offset + 4] == PCAPNG_MAGIC:
                order = _order(content, offset)
                interfaces = []
            kind, length = struct.unpack_from(f"{order}II", content, offset)
            if length < 12 or length % 4 or length > 2 * LONGEST_PACKET:
                raise CaptureError(f"offset {offset}: a block of {length} bytes")
            if offset + length > len(content):
                break
            (again,) = struct.unpack_from(f"{order}I", content, offset + length - 4)
            if again != length:
                raise CaptureError(
                    f"offset {offset}: a block of {length} bytes ends as one of {again}"
                )
            body = content[offset + 8 : offset + length - 4]
            if kind == _INTERFACE:
                interfaces.append(_interface(body, order, offset))
                if len(interfaces) > MOST_INTERFACES:
                    raise CaptureError(f"offset {offset}: more than {MOST_INTERFACES} interfaces")
            elif kind == _ENHANCED_PACKET:
                packet = _enhanced(body, order, offset, interfaces)
                if packet is not None:
                    yield packet
            offset += length
        self.cut = offset < len(content)


# ------------------------------------------------------------------------------------------------- pcapng

_INTERFACE: Final = 1
_ENHANCED_PACKET: Final = 6
_OPTION_END: Final = 0
_OPTION_RESOLUTION: Final = 9
_OPTION_OFFSET: Final = 14


class _Interface(NamedTuple):
    """Link type, s of one unit of time, and s to be added to a time."""

    link: int
    unit: float
    zero: int


def _order(content: bytes, offset: int) -> str:
    magic = content[offset + 8 : offset + 12]
    if magic == b"\x1a\x2b\x3c\x4d":
        return ">"
    if magic == b"\x4d\x3c\x2b\x1a":
        return "<"
    raise CaptureError(f"offset {offset}: a section without a byte order")


def _interface(body: bytes, order: str, offset: int) -> _Interface:
    if len(body) < 8:
        raise CaptureError(f"offset {offset}: an interface of {len(body)} bytes")
    (link,) = struct.unpack_from(f"{order}H", body)
    unit, zero, at = 1e-6, 0, 8
    while len(body) - at >= 4:
        code, length = struct.unpack_from(f"{order}HH", body, at)
        value = body[at + 4 : at + 4 + length]
        if code == _OPTION_END or len(value) < length:
            break
        if code == _OPTION_RESOLUTION and length == 1:
            unit = (2.0 if value[0] & 0x80 else 10.0) ** -(value[0] & 0x7F)
        if code == _OPTION_OFFSET and length == 8:
            (zero,) = struct.unpack(f"{order}q", value)
        at += 4 + (length + 3) // 4 * 4
    return _Interface(link, unit, zero)


def _enhanced(body: bytes, order: str, offset: int, interfaces: list[_Interface]) -> Packet | None:
    if len(body) < 20:
        raise CaptureError(f"offset {offset}: a packet of {len(body)} bytes")
    number, high, low, length, whole = struct.unpack_from(f"{order}IIIII", body)
    if number >= len(interfaces):
        raise CaptureError(f"offset {offset}: a packet of interface {number}, which is not there")
    if length > len(body) - 20:
        raise CaptureError(f"offset {offset}: {length} bytes of a packet in {len(body) - 20}")
    if length < whole:
        return None
    interface = interfaces[number]
    time = ((high << 32) | low) * interface.unit + interface.zero
    return Packet(time, interface.link, body[20 : 20 + length], offset)


# --------------------------------------------------------------------------------- from link to datagram

Ip = bytes | None
"""A packet of IPv4; None for another."""


def _after(header: int, kind_at: int) -> Callable[[bytes], Ip]:
    """Return what takes a header off that has the EtherType at an offset."""

    def take(data: bytes) -> Ip:
        if len(data) < header or struct.unpack_from(">H", data, kind_at)[0] != _IPV4:
            return None
        return data[header:]

    return take


def _ethernet(data: bytes) -> Ip:
    at = 12
    while len(data) >= at + 2:
        (kind,) = struct.unpack_from(">H", data, at)
        if kind == _IPV4:
            return data[at + 2 :]
        if kind not in _VLAN_TAGS:
            return None
        at += 4
    return None


def _loopback(data: bytes) -> Ip:
    """BSD's: the address family of IPv4 is 2 everywhere, in the order of the machine that captured."""
    return data[4:] if data[:4] in (b"\x02\0\0\0", b"\0\0\0\x02") else None


def _raw(data: bytes) -> Ip:
    return data


_LINKS: Final[Mapping[int, Callable[[bytes], Ip]]] = {
    0: _loopback,  # NULL
    1: _ethernet,
    12: _raw,
    14: _raw,
    101: _raw,
    108: _loopback,  # LOOP
    113: _after(16, 14),  # Linux cooked
    228: _raw,  # IPv4
    276: _after(20, 0),  # Linux cooked v2
}
"""What takes the header of a link off, by link type."""


def _udp(data: Ip) -> tuple[str, int, bytes] | None:
    """Return source address, source port and payload; None for what is no whole datagram of UDP."""
    if data is None or len(data) < 20 or data[0] >> 4 != 4:
        return None
    header = (data[0] & 0x0F) * 4
    length, fragment = struct.unpack_from(">H2xH", data, 2)
    if data[9] != _UDP or fragment & 0x3FFF or not 20 <= header <= length - 8 <= len(data) - 8:
        return None
    port, _, size = struct.unpack_from(">HHH", data, header)
    if not 8 <= size <= length - header:
        return None
    source = str(ipaddress.IPv4Address(data[12:16]))
    return source, port, data[header + 8 : header + size]
