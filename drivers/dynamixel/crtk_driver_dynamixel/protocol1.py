"""DYNAMIXEL protocol 1.0: instruction packets to bytes, bytes to status packets. No I/O, no clock.

A packet is ``FF FF | id | length | instruction | parameters | checksum``: the length counts instruction to
checksum, the checksum is the inverted sum of id to parameters. A status has the error bits in the place of
the instruction, so that an echo of a request looks like a status and is told from it by its bytes.
Addresses and lengths are one byte. (E-manual, https://emanual.robotis.com/docs/en/dxl/protocol1/.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from types import MappingProxyType
from typing import Final

from typing_extensions import override

from crtk_driver_dynamixel import framing
from crtk_driver_dynamixel.framing import Status

HEADER: Final = b"\xff\xff"
BROADCAST: Final = 0xFE
HIGHEST_ID: Final = 253
MOST_PARAMETERS: Final = 0xFF - 2
TAIL: Final = 1
"""Bytes of the checksum."""
_FRAME: Final = 4
"""Bytes of a packet that its length does not count."""
_SHORTEST: Final = 2
"""Length field of a packet without parameters."""


class Instruction(IntEnum):
    """E-manual, "Instruction"; Bulk Read is known to the MX series only."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    SYNC_WRITE = 0x83
    BULK_READ = 0x92


ERRORS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0x01: "input voltage out of range",
        0x02: "goal position beyond the angle limits",
        0x04: "overheating",
        0x08: "a value or address is out of range",
        0x10: "checksum error: the packet arrived damaged",
        0x20: "overload",
        0x40: "instruction error: unknown, or Action came without Reg Write",
    }
)
"""Bits of the error byte of every status (e-manual, "Error")."""

HARDWARE: Final = 0x01 | 0x04 | 0x20
"""Those of the error bits that say how the servo is, not what was wrong with the request."""


def error_text(error: int) -> str:
    """Return what error bits say; empty for 0."""
    return ", ".join(text for bit, text in ERRORS.items() if error & bit)


def checksum(data: bytes) -> int:
    """Return the checksum of id to parameters."""
    return ~sum(data) & 0xFF


def packet(id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return the bytes of an instruction packet.

    Raises:
        ValueError: an id that no servo can have, or more parameters than a packet holds.
    """
    if not 0 <= id <= HIGHEST_ID and id != BROADCAST:
        raise ValueError(f"no DYNAMIXEL id: {id} (0 to {HIGHEST_ID}, or {BROADCAST} for all)")
    if len(parameters) > MOST_PARAMETERS:
        raise ValueError(f"{len(parameters)} bytes do not fit into one packet of protocol 1.0")
    return seal(HEADER + bytes((id, len(parameters) + _SHORTEST, instruction)) + parameters)


def seal(unsealed: bytes | bytearray) -> bytes:
    """Append the checksum to a packet that lacks it."""
    data = bytes(unsealed)
    return data + bytes((checksum(data[len(HEADER) :]),))


def _byte(number: int) -> bytes:
    if not 0 <= number <= 0xFF:
        raise ValueError(f"not an address or length of protocol 1.0: {number}")
    return bytes((number,))


def _distinct(ids: Sequence[int]) -> None:
    if not ids:
        raise ValueError("no ids given")
    for id in ids:
        if not 0 <= id <= HIGHEST_ID:
            raise ValueError(f"no id of one DYNAMIXEL: {id} (0 to {HIGHEST_ID})")
    if len(set(ids)) != len(ids):
        raise ValueError(f"an id may occur only once: {list(ids)}")


def ping(id: int) -> bytes:
    """Ask for a status."""
    return packet(id, Instruction.PING)


def read(id: int, address: int, length: int) -> bytes:
    """Ask for `length` bytes from `address`."""
    return packet(id, Instruction.READ, _byte(address) + _byte(length))


def write(id: int, address: int, data: bytes) -> bytes:
    """Write; a broadcast is not replied to."""
    return packet(id, Instruction.WRITE, _byte(address) + data)


def reboot(id: int) -> bytes:
    """Restart; newer models only."""
    return packet(id, Instruction.REBOOT)


def sync_write(address: int, length: int, values: Mapping[int, bytes]) -> bytes:
    """Write the same range of several servos: `values` are `length` bytes by id. There is no reply."""
    _distinct(list(values))
    for id, data in values.items():
        if len(data) != length:
            raise ValueError(f"id {id}: {len(data)} bytes given for a range of {length}")
    listed = b"".join([bytes((id,)) + data for id, data in values.items()])
    return packet(BROADCAST, Instruction.SYNC_WRITE, _byte(address) + _byte(length) + listed)


def bulk_read(items: Sequence[tuple[int, int, int]]) -> bytes:
    """Ask for (id, address, length) of several servos, each id once; each replies in this order."""
    _distinct([id for id, _, _ in items])
    listed = b"".join([_byte(length) + bytes((id,)) + _byte(at) for id, at, length in items])
    return packet(BROADCAST, Instruction.BULK_READ, b"\x00" + listed)


def status_size(parameters: int) -> int:
    """Return the size in bytes of a status with so many parameters."""
    return _FRAME + _SHORTEST + parameters


class StatusParser(framing.StatusParser):
    """Turns what arrives into status packets; see `framing.StatusParser`.

    `Status.error` holds the error bits that concern the request, `Status.hardware` those of `HARDWARE`.
    """

    header = HEADER
    head_size = _FRAME
    header_skip = 1

    def __init__(self, longest: int = 0xFF + _FRAME) -> None:
        super().__init__(longest)

    @override
    def _size(self, buffer: bytearray) -> int:
        if len(buffer) < _FRAME:
            return _FRAME
        size = _FRAME + buffer[3]
        possible = buffer[2] != 0xFF and _FRAME + _SHORTEST <= size <= self.longest
        return size if possible else 0

    @override
    def _id(self, packet: bytes | bytearray) -> int:
        return packet[2]

    @override
    def _is_valid(self, packet: bytes) -> bool:
        return checksum(packet[2:-1]) == packet[-1]

    @override
    def _waits(self, packet: bytes) -> bool:
        return packet == self._request

    @override
    def _status(self, packet: bytes, *, last: bool) -> Status | None:
        is_echo = packet == self._request and not last
        self._request = b""
        if is_echo:
            return None
        error, hardware = packet[4] & ~HARDWARE, packet[4] & HARDWARE
        return Status(packet[2], error, hardware != 0, packet[5:-1], hardware)
