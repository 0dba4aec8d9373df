"""CRC-16 with the polynomial 0x8005, reflected: Modbus begins with FFFF, ARC (NDI and others) with 0."""

from __future__ import annotations

from typing import Final

__all__ = ["reflected_crc16"]

_REFLECTED: Final = 0xA001


def _remainder(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (_REFLECTED if byte & 1 else 0)
    return byte


_TABLE: Final = tuple(map(_remainder, range(256)))


def reflected_crc16(data: bytes, start: int = 0) -> int:
    """Return the CRC of `data`; `start` is what it begins with, or the CRC of what went before it."""
    crc = start
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc
