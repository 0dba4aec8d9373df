"""Tool definition files (.rom): read, checked, and cut for their way to the tracker. Pure but for reading.

Layout: JHU's rom generator (jhu-saw/sawNDITracker, core/share/roms), and measured on the files beside it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from crtk_drivers.config.capped_file import read_capped
from crtk_drivers.errors import ConfigError

__all__ = ["CHUNK", "LEAST_MARKERS", "SIZE", "TYPES", "Rom", "parse_rom", "read_rom"]

SIZE: Final = 752
LONGEST: Final = 1024
"""Bytes of the memory that such a file is an image of."""
CHUNK: Final = 64
"""Bytes that PVWR takes at a time."""

MOST_MARKERS: Final = 20
LEAST_MARKERS: Final = 3
"""Of a tool that cameras see; a wired one of an Aurora has a sensor or two."""

TYPES: Final[Mapping[int, str]] = MappingProxyType(
    {
        1: "reference",
        2: "pointer",
        3: "button box",
        4: "user defined",
        5: "microscope",
        7: "calibration",
        8: "dock",
        9: "isolation box",
        10: "C-arm",
        11: "catheter",
        12: "GPIO",
        14: "scan reference",
    }
)


@dataclass(frozen=True, slots=True)
class Rom:
    """A tool as its definition has it.

    Attributes:
        data: the file (752 bytes).
        manufacturer, part_number: as engraved.
        kind: main type, see `TYPES`.
        revision: of the file.
        markers: x, y, z of each in the tool's frame, in mm; of an Aurora's tool its sensors.
        least_markers: that must be seen for a pose.
        largest_error, largest_angle: of a marker, in mm and degrees.
    """

    data: bytes
    manufacturer: str
    part_number: str
    kind: int
    revision: int
    markers: tuple[tuple[float, float, float], ...]
    least_markers: int
    largest_error: float
    largest_angle: int

    @property
    def chunks(self) -> list[tuple[int, bytes]]:
        """Address and bytes for each PVWR; the last one is filled up with zeros."""
        starts = range(0, len(self.data), CHUNK)
        return [(at, self.data[at : at + CHUNK].ljust(CHUNK, b"\0")) for at in starts]


def parse_rom(data: bytes) -> Rom:
    """Return the tool of a definition.

    Raises:
        ValueError: it is none, or damaged.
    """
    if len(data) < SIZE or data[:4] != b"NDI\0":
        raise ValueError(f"{len(data)} bytes that begin with {data[:4]!r} are no tool definition")
    data = data[:SIZE]
    (wanted,) = struct.unpack_from("<H", data, 4)
    found = sum(data[6:]) & 0xFFFF
    if found != wanted:
        raise ValueError(f"damaged: the checksum is {found:04X}, and should be {wanted:04X}")
    count = data[28]
    if not 1 <= count <= MOST_MARKERS:
        raise ValueError(f"{count} markers")
    return Rom(
        data=data,
        manufacturer=_text(data[580:592]),
        part_number=_text(data[592:612]),
        kind=data[15],
        revision=struct.unpack_from("<H", data, 16)[0],
        markers=tuple(struct.unpack_from("<3f", data, 72 + 12 * index) for index in range(count)),
        least_markers=data[32],
        largest_error=struct.unpack_from("<f", data, 36)[0],
        largest_angle=data[24],
    )


def read_rom(path: str | Path) -> Rom:
    """Return the tool of a file.

    Raises:
        ConfigError: it cannot be read, is none, or is damaged.
    """
    data = read_capped(Path(path), LONGEST, "a tool definition (.rom)")
    try:
        return parse_rom(data)
    except ValueError as error:
        raise ConfigError(
            f"{error}", where=str(path), remedy="Take the .rom file that came with the tool."
        ) from error


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("ascii", "replace").strip()
