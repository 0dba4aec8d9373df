"""CRC-16 of NDI's commands and replies: polynomial 0x8005 reflected, start 0 (CRC-16/ARC).

Source: Combined API guide, "CRC". `crc16` is fastcrc's where it is installed, the kit's elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable

from crtk_drivers.kit.crc16 import reflected_crc16

__all__ = ["crc16"]

crc16: Callable[[bytes], int]
"""CRC of bytes."""
try:
    from fastcrc.crc16 import arc as crc16
except ImportError:
    crc16 = reflected_crc16
