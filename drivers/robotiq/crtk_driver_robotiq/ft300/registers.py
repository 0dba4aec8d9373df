"""The registers of the sensor that are asked for and written. Pure: no I/O.

Source: FT 300 instruction manual, 4.7.1 (register map), and rq_sensor_com.c of Robotiq.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_driver_robotiq.ft300.stream import SCALE

__all__ = ["FIRMWARE", "LOADS", "SERIAL", "STREAM", "STREAM_ON", "YEAR", "Identity", "loads_of"]

LOADS: Final = (180, 6)
"""First register, and how many: forces and moments."""
STREAM: Final = 410
"""What is sent by itself."""
STREAM_ON: Final = b"\x02\x00"
FIRMWARE: Final = (500, 3)
SERIAL: Final = (510, 4)
YEAR: Final = (514, 1)

_COUNTS: Final = struct.Struct(">6h")


@dataclass(frozen=True, slots=True)
class Identity:
    """What the sensor says of itself."""

    firmware: str
    serial: str
    year: int

    @classmethod
    def parse(cls, firmware: bytes, serial: bytes, year: bytes) -> Identity:
        """Return what these registers say; texts end with a zero, and what is no text is left out."""
        return cls(_text(firmware), _text(serial), int.from_bytes(year))

    @property
    def is_sensor(self) -> bool:
        """Whether it is one: its firmware's name begins with an F."""
        return self.firmware.startswith("F")

    @property
    def described(self) -> str:
        """For people."""
        parts = (
            "FT 300",
            f"serial {self.serial}" if self.serial else "",
            f"firmware {self.firmware}",
            f"of {self.year}" if self.year else "",
        )
        return ", ".join(filter(None, parts))


def _text(data: bytes) -> str:
    text = data.partition(b"\0")[0].decode("ascii", "ignore")
    return "".join(filter(str.isprintable, text)).strip()


def loads_of(data: bytes) -> NDArray[np.float64]:
    """Return the load (6,) in N and N·m of the registers `LOADS`.

    Raises:
        struct.error: they are not six.
    """
    load: NDArray[np.float64] = SCALE * _COUNTS.unpack(data)
    return load
