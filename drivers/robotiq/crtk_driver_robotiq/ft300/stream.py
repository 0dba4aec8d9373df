"""The data stream of the sensor: bytes to loads. Pure: no I/O.

Sixteen bytes a measurement, 100 times a second: 20 4E, six numbers of 16 bits with their low byte first, and
the CRC of Modbus over all before it. Source: FT 300 instruction manual, 4.7.2; rq_sensor_com.c of Robotiq.
"""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.kit import SeekingDecoder
from crtk_drivers.kit.crc16 import reflected_crc16

__all__ = ["FRAME", "PERIOD", "SCALE", "STOP", "stream_decoder"]

HEAD: Final = b"\x20\x4e"
FRAME: Final = 16
"""Bytes of a measurement."""
PERIOD: Final = 0.01
"""Seconds from one to the next."""
SCALE: Final = np.array([0.01, 0.01, 0.01, 0.001, 0.001, 0.001])
"""N and N·m of one count, in the stream and in registers."""
STOP: Final = b"\xff" * 50
"""What ends the stream; a sensor that does not stream takes it for noise."""

_COUNTS: Final = struct.Struct("<6h")


def stream_decoder() -> SeekingDecoder[NDArray[np.float64]]:
    """Return what finds loads (6,), N and N·m, in a stream that may be damaged and begin anywhere."""
    return SeekingDecoder(HEAD, lambda _: FRAME, _load)


def _load(frame: bytes) -> NDArray[np.float64]:
    if _crc(frame[:-2]) != frame[-2:]:
        raise ValueError("its CRC is wrong")
    load: NDArray[np.float64] = SCALE * _COUNTS.unpack(frame[2:-2])
    return load


def _crc(data: bytes) -> bytes:
    return reflected_crc16(data, 0xFFFF).to_bytes(2, "little")
