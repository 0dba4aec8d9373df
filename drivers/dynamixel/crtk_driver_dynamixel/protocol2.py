"""DYNAMIXEL protocol 2.0: instruction packets to bytes, bytes to status packets. No I/O, no clock.

A packet is ``FF FF FD 00 | id | length | instruction | parameters | CRC``: two-byte numbers little-endian,
the length counts instruction to CRC. Inside instruction and parameters each ``FF FF FD`` is followed by one
more ``FD`` (stuffing), so that a header cannot occur there; length and CRC are those of the stuffed bytes.
A status has instruction 55, and the error byte before its parameters. The reply to a fast read has no
stuffing. (E-manual, https://emanual.robotis.com/docs/en/dxl/protocol2/.)
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from types import MappingProxyType
from typing import Final

from typing_extensions import override

from crtk_driver_dynamixel import framing
from crtk_driver_dynamixel.crc import crc16
from crtk_driver_dynamixel.framing import Status

HEADER: Final = b"\xff\xff\xfd\x00"
BROADCAST: Final = 0xFE
HIGHEST_ID: Final = 252
MOST: Final = 4096
"""Largest length that we send, without stuffing."""
TAIL: Final = 2
"""Bytes of the CRC."""
STATUS: Final = 0x55
ALERT: Final = 0x80
"""Bit of the error byte: Hardware Error Status of this servo is not 0."""

_HEAD: Final = struct.Struct("<4sBH")
_U16: Final = struct.Struct("<H")
_FRAME: Final = _HEAD.size + TAIL
_SHORTEST: Final = 3
"""Length field of the shortest packet: an instruction and the CRC."""
SEQUENCE: Final = b"\xff\xff\xfd"
"""What is stuffed with one more FD."""
_STUFFED: Final = b"\xff\xff\xfd\xfd"


class Instruction(IntEnum):
    """E-manual, "Instruction"."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    FAST_BULK_READ = 0x9A


ERRORS: Final[Mapping[int, str]] = MappingProxyType(
    {
        1: "result fail: it could not do what the packet asks for",
        2: "instruction error: it does not know the instruction, or Action came without Reg Write",
        3: "CRC error: the packet arrived damaged",
        4: "data range error: the value is outside the range of the register",
        5: "data length error: fewer bytes than the register has",
        6: "data limit error: the value is beyond a limit that is set in the control table",
        7: "access error: the register cannot be written now, or is not there "
        "(EEPROM is written only while torque is off)",
    }
)
"""Number in the error byte of a status (e-manual, "Error")."""


def error_text(error: int) -> str:
    """Return what an error number says; empty for 0."""
    return ERRORS.get(error, f"unknown error {error}") if error else ""


def packet(id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return the bytes of an instruction packet.

    Raises:
        ValueError: an id that no servo can have, or more parameters than a packet holds.
    """
    if not 0 <= id <= HIGHEST_ID and id != BROADCAST:
        raise ValueError(f"no DYNAMIXEL id: {id} (0 to {HIGHEST_ID}, or {BROADCAST} for all)")
    body = bytes((instruction,)) + parameters
    if len(body) + TAIL > MOST:
        raise ValueError(f"{len(parameters)} parameters do not fit into one packet")
    return seal(_HEAD.pack(HEADER, id, len(body) + TAIL) + body)


def seal(unsealed: bytes | bytearray) -> bytes:
    """Stuff a packet that lacks its CRC, where there is anything to stuff, and append the CRC.

    Raises:
        ValueError: more bytes than a packet holds.
    """
    data = bytes(unsealed)
    if SEQUENCE in data[_HEAD.size :]:
        body = data[_HEAD.size :].replace(SEQUENCE, _STUFFED)
        data = _HEAD.pack(HEADER, data[4], len(body) + TAIL) + body
    return data + crc16(data).to_bytes(TAIL, "little")


def _u16(number: int) -> bytes:
    if not 0 <= number <= 0xFFFF:
        raise ValueError(f"not an address or length of a control table: {number}")
    return _U16.pack(number)


def _distinct(ids: Iterable[int]) -> bytes:
    listed = list(ids)
    if not listed:
        raise ValueError("no ids given")
    for id in listed:
        if not 0 <= id <= HIGHEST_ID:
            raise ValueError(f"no id of one DYNAMIXEL: {id} (0 to {HIGHEST_ID})")
    if len(set(listed)) != len(listed):
        raise ValueError(f"an id may occur only once: {listed}")
    return bytes(listed)


def ping(id: int) -> bytes:
    """Ask for model number and firmware version; `BROADCAST` asks all, which reply in order of ids."""
    return packet(id, Instruction.PING)


def read(id: int, address: int, length: int) -> bytes:
    """Ask for `length` bytes from `address`."""
    return packet(id, Instruction.READ, _u16(address) + _u16(length))


def write(id: int, address: int, data: bytes) -> bytes:
    """Write; a broadcast is not replied to."""
    return packet(id, Instruction.WRITE, _u16(address) + data)


def reboot(id: int) -> bytes:
    """Restart: torque goes off, the hardware error is cleared, RAM is reset."""
    return packet(id, Instruction.REBOOT)


def sync_read(ids: Sequence[int], address: int, length: int) -> bytes:
    """Ask several servos for the same range; each replies with a status of its own, in this order."""
    return packet(BROADCAST, Instruction.SYNC_READ, _u16(address) + _u16(length) + _distinct(ids))


def fast_sync_read(ids: Sequence[int], address: int, length: int) -> bytes:
    """Ask several servos for the same range; they reply with one status between them."""
    return packet(
        BROADCAST, Instruction.FAST_SYNC_READ, _u16(address) + _u16(length) + _distinct(ids)
    )


def sync_write(address: int, length: int, values: Mapping[int, bytes]) -> bytes:
    """Write the same range of several servos: `values` are `length` bytes by id. There is no reply."""
    _distinct(values)
    for id, data in values.items():
        if len(data) != length:
            raise ValueError(f"id {id}: {len(data)} bytes given for a range of {length}")
    listed = b"".join([bytes((id,)) + data for id, data in values.items()])
    return packet(BROADCAST, Instruction.SYNC_WRITE, _u16(address) + _u16(length) + listed)


def _items(items: Sequence[tuple[int, int, int]]) -> bytes:
    _distinct([id for id, _, _ in items])
    return b"".join([bytes((id,)) + _u16(address) + _u16(n) for id, address, n in items])


def bulk_read(items: Sequence[tuple[int, int, int]]) -> bytes:
    """Ask for (id, address, length) of several servos, each id once; each replies in this order."""
    return packet(BROADCAST, Instruction.BULK_READ, _items(items))


def fast_bulk_read(items: Sequence[tuple[int, int, int]]) -> bytes:
    """Ask for (id, address, length) of several servos; they reply with one status between them."""
    return packet(BROADCAST, Instruction.FAST_BULK_READ, _items(items))


def status_size(parameters: int) -> int:
    """Return the size in bytes of a status with so many parameters, without stuffing."""
    return _FRAME + 2 + parameters


def status_prefix(id: int, parameters: int) -> bytes:
    """Return the bytes before the error byte of a status with so many parameters, without stuffing."""
    return _HEAD.pack(HEADER, id, parameters + 2 + TAIL) + bytes((STATUS,))


class StatusParser(framing.StatusParser):
    """Turns what arrives into status packets; see `framing.StatusParser`."""

    header = HEADER
    head_size = _HEAD.size
    header_skip = len(HEADER)

    def __init__(self, longest: int = 4096) -> None:
        super().__init__(longest)

    @override
    def _size(self, buffer: bytearray) -> int:
        if len(buffer) < _HEAD.size:
            return _HEAD.size
        size = _HEAD.size + (buffer[5] | buffer[6] << 8)
        return size if _HEAD.size + _SHORTEST <= size <= self.longest else 0

    @override
    def _id(self, packet: bytes | bytearray) -> int:
        return packet[4]

    @override
    def _is_valid(self, packet: bytes) -> bool:
        if packet[7] == STATUS and len(packet) < status_size(0):
            return False
        return crc16(packet[:-2]) == packet[-2] | packet[-1] << 8

    @override
    def _status(self, packet: bytes, *, last: bool) -> Status | None:
        if packet[7] != STATUS:
            return None
        id, error, params = packet[4], packet[8], packet[9:-2]
        if id != BROADCAST:
            params = params.replace(_STUFFED, SEQUENCE)
        return Status(id, error & ~ALERT, error >= ALERT, params)
