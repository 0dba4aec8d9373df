"""CRC-16 of NDI's commands and replies: polynomial 0x8005 reflected, start 0 (CRC-16/ARC).

Source: Combined API guide, "CRC". `crc16` is fastcrc's where it is installed, `table_crc16` elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

__all__ = ["crc16", "table_crc16"]

_REFLECTED: Final = 0xA001


def _remainder(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (_REFLECTED if byte & 1 else 0)
    return byte


_TABLE: Final = tuple(map(_remainder, range(256)))


def table_crc16(data: bytes, start: int = 0) -> int:
    """Return the CRC of `data`; `start` is the CRC of what went before it."""
    crc = start
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


crc16: Callable[[bytes], int]
"""CRC of bytes."""
try:
    from fastcrc.crc16 import arc as crc16
except ImportError:
    crc16 = table_crc16
