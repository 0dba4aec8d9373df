"""Modbus as a device answers it: requests to replies, and both kinds of framing. No port, no clock."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from typing import Final, Protocol

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
MOST: Final = 125
"""Registers that can be read at once."""
ALL: Final = frozenset({3, 4, 6, 16, 23})
"""Functions that are known here."""
_READ: Final = (3, 4)
_WRITE_ONE: Final = 6
_WRITE: Final = 16
_READ_WRITE: Final = 23


class Refused(Exception):
    """An exception of Modbus; its argument is the code."""


class Registers(Protocol):
    """What is behind the registers of a device. Both raise `Refused`, and change nothing then."""

    @property
    def functions(self) -> Collection[int]:
        """Which it knows, of 3, 4, 6, 16 and 23."""

    def read(self, address: int, count: int) -> bytes:
        """Return the bytes of so many registers, high byte first."""

    def write(self, address: int, data: bytes) -> None:
        """Take the bytes of registers from an address on."""


def window(base: int, size: int, address: int, count: int) -> slice:
    """Return where the bytes of so many registers are in a block of `size` that begins at `base`.

    Raises:
        Refused: not all of them are in it.
    """
    if not base <= address <= address + count <= base + size:
        raise Refused(ILLEGAL_ADDRESS)
    return slice(2 * (address - base), 2 * (address - base + count))


def answer(device: Registers, request: bytes) -> bytes:
    """Carry out a request (function and data), and return its reply."""
    function = request[0]
    try:
        return bytes((function,)) + _carry_out(device, function, request[1:])
    except Refused as refused:
        return bytes((function | 0x80, refused.args[0]))
    except (struct.error, IndexError):
        return bytes((function | 0x80, ILLEGAL_VALUE))


def _carry_out(device: Registers, function: int, data: bytes) -> bytes:
    if function not in device.functions:
        raise Refused(ILLEGAL_FUNCTION)
    if function in _READ:
        return _read(device, *struct.unpack(">HH", data))
    if function == _WRITE_ONE:
        address, _ = struct.unpack(">HH", data)
        device.write(address, data[2:])
        return data
    if function == _WRITE:
        address, count, size = struct.unpack_from(">HHB", data)
        _check_size(count, size, data[5:])
        device.write(address, data[5:])
        return data[:4]
    if function == _READ_WRITE:
        read, wanted, address, count, size = struct.unpack_from(">HHHHB", data)
        _check_size(count, size, data[9:])
        _read(device, read, wanted)
        device.write(address, data[9:])
        return _read(device, read, wanted)
    raise Refused(ILLEGAL_FUNCTION)


def _check_size(count: int, size: int, data: bytes) -> None:
    if not count or size != 2 * count or len(data) != size:
        raise Refused(ILLEGAL_VALUE)


def _read(device: Registers, address: int, count: int) -> bytes:
    if not 0 < count <= MOST:
        raise Refused(ILLEGAL_VALUE)
    return bytes((2 * count,)) + device.read(address, count)


# ------------------------------------------------------------------------------------------- framing


def crc(data: bytes) -> bytes:
    """Return the CRC-16 of Modbus, low byte first (Modbus over Serial Line 1.02, 6.2.2)."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")


def request_size(data: bytes) -> int:
    """Return how long the request at the start of a line's bytes is with its CRC; 0: not to be told yet."""
    if len(data) < 2:
        return 0
    at = {_WRITE: 6, _READ_WRITE: 10}.get(data[1])
    if at is None:
        return 8
    return at + 1 + data[at] + 2 if len(data) > at else 0


def rtu_requests(data: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """Return the requests in what a line has carried, each with its unit, and what may become one.

    Where no request begins, a byte is left out, and the next one tried.
    """
    found: list[tuple[int, bytes]] = []
    while size := request_size(data):
        if size > len(data):
            break
        frame = data[:size]
        if crc(frame[:-2]) == frame[-2:]:
            found.append((frame[0], frame[1:-2]))
            data = data[size:]
        else:
            data = data[1:]
    return found, data


def mbap_requests(data: bytes) -> Iterator[tuple[bytes, int, bytes]]:
    """Yield transaction, unit and request of each whole frame of Modbus TCP; then what is left, unit -1."""
    while len(data) >= 8:
        transaction, protocol, size = data[:2], data[2:4], int.from_bytes(data[4:6])
        if protocol != b"\0\0" or not 2 <= size <= 254:
            raise ValueError("this is not Modbus TCP")
        if len(data) < 6 + size:
            break
        yield transaction, data[6], data[7 : 6 + size]
        data = data[6 + size :]
    yield b"", -1, data
