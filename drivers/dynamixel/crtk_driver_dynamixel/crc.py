"""CRC-16 of protocol 2.0: polynomial 0x8005, start 0, not reflected (CRC-16/UMTS).

Source: e-manual, "CRC Calculation". `crc16` is fastcrc's where it is installed, `table_crc16` elsewhere.
"""

from __future__ import annotations

from typing import Final, Protocol

_POLYNOMIAL: Final = 0x8005


def _remainder(high_byte: int) -> int:
    value = high_byte << 8
    for _ in range(8):
        value = value << 1 ^ (_POLYNOMIAL if value & 0x8000 else 0)
    return value & 0xFFFF


_TABLE: Final = tuple(map(_remainder, range(256)))


def table_crc16(data: bytes | bytearray | memoryview, start: int = 0) -> int:
    """Return the CRC of `data`; `start` is the CRC of what went before it."""
    crc = start
    for byte in data:
        crc = (crc & 0xFF) << 8 ^ _TABLE[crc >> 8 ^ byte]
    return crc


class _Crc16(Protocol):
    def __call__(self, data: bytes | bytearray | memoryview, start: int = 0, /) -> int: ...


crc16: _Crc16
"""CRC of `data`; the second argument is the CRC of what went before it."""
try:
    from fastcrc.crc16 import umts as crc16
except ImportError:
    crc16 = table_crc16
