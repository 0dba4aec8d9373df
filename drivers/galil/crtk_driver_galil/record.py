"""The data record, which a controller sends by itself (DR) or when it is asked (QR): bytes in, values out.

Source: Galil user manuals, chapter 4 (Data Record), by model. Little-endian. The layouts agree byte for byte
with two published clients.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

AXES: Final = "ABCDEFGH"

VOLTS: Final = 9.9982 / 32767.0
"""V for one count of torque (TT)."""

VELOCITY: Final = 1.0 / 64.0
"""Counts a second for one count of velocity: the record has 64 times what TV tells."""

MOVING: Final = 0x8000
HOMING: Final = 0x0800
MOTOR_OFF: Final = 0x0001
"""Bits of the status of an axis."""

FORWARD_LIMIT: Final = 0x08
REVERSE_LIMIT: Final = 0x04
HOME: Final = 0x02
"""Bits of the switches of an axis, set where the switch is active; which level that is, CN says."""


class Layout(NamedTuple):
    """Where things are in the record of a family of controllers.

    Attributes:
        name: of the family.
        axes_at: first byte of the first axis.
        axis_size: bytes of each axis.
        has_header: it begins with four bytes that tell blocks, axes and size.
        sample_at: of the sample number.
        error_at: of the error code (TC).
        amplifier_at: of the amplifier status; None where there is none.
    """

    name: str
    axes_at: int
    axis_size: int
    has_header: bool
    sample_at: int
    error_at: int
    amplifier_at: int | None


LAYOUTS: Final[Mapping[str, Layout]] = MappingProxyType(
    {
        layout.name: layout
        for layout in (
            Layout("4000", 82, 36, True, 4, 50, 52),
            Layout("52000", 82, 36, True, 4, 50, 52),
            Layout("30000", 38, 36, True, 4, 10, 18),
            Layout("2103", 44, 30, True, 4, 26, None),
            Layout("1806", 78, 30, False, 0, 46, None),
            Layout("1802", 40, 30, False, 0, 22, None),
        )
    }
)
"""By family."""

_FAMILIES: Final = (
    ("1806", "1806"),
    ("1802", "1802"),
    ("52", "52000"),
    ("50", "4000"),
    ("4", "4000"),
    ("3", "30000"),
    ("2", "2103"),
)
"""How the number of a model begins, and its family; the first that fits."""

_MODEL: Final = re.compile(r"DMC\s*-?(\d{4,5})", re.IGNORECASE)


def layout_of(revision: str) -> Layout | None:
    """Return the layout of a controller by its revision (``^R^V``); None if it is not known."""
    found = _MODEL.search(revision)
    if found is None:
        return None
    return next((LAYOUTS[name] for begin, name in _FAMILIES if found[1].startswith(begin)), None)


@dataclass(frozen=True, slots=True)
class AxisRecord:
    """One axis. Positions in counts, velocity in counts/s, torque in V.

    Attributes:
        status: see `MOVING` and the others.
        switches: see `FORWARD_LIMIT` and the others.
        stop_code: why it does not move (SC).
        reference: where its profile is (RP).
        position: of the motor's encoder (TP).
        error: how far that is behind (TE).
    """

    status: int
    switches: int
    stop_code: int
    reference: int
    position: int
    error: int
    velocity: float
    torque: float

    @property
    def is_moving(self) -> bool:
        """Whether its profile runs."""
        return bool(self.status & MOVING)

    @property
    def motor_off(self) -> bool:
        """Whether its motor has no power."""
        return bool(self.status & MOTOR_OFF)


@dataclass(frozen=True, slots=True)
class Record:
    """One data record.

    Attributes:
        sample: number of the sample of the controller, 16 bits.
        error_code: of the last refused command (TC); 0: none.
        amplifier: status of internal amplifiers; 0 where there are none.
        axes: by letter.
    """

    sample: int
    error_code: int
    amplifier: int
    axes: Mapping[str, AxisRecord]


_AXIS: Final = struct.Struct("<HBBiiiiii")
_HEADER: Final = struct.Struct("<BBH")
_PRESENT: Final = 0x80


def parse(data: bytes, layout: Layout, count: int = 8) -> Record:
    """Return the record of bytes.

    Args:
        data: one whole record.
        layout: of the family.
        count: axes of a controller whose record has no header.

    Raises:
        ValueError: it is none of this family, with what does not fit.
    """
    letters = AXES[:count]
    if layout.has_header:
        if len(data) < _HEADER.size:
            raise ValueError(f"{len(data)} bytes are no data record")
        flags, mask, size = _HEADER.unpack_from(data)
        if not flags & _PRESENT:
            raise ValueError(f"a data record does not begin with 0x{flags:02x}")
        letters = "".join(letter for bit, letter in enumerate(AXES) if mask >> bit & 1)
        wanted = layout.axes_at + layout.axis_size * len(letters)
        if size != wanted:
            raise ValueError(
                f"its header tells {size} bytes, where axes {letters} of the family {layout.name} have "
                f"{wanted}"
            )
    else:
        wanted = layout.axes_at + layout.axis_size * count
    if len(data) != wanted:
        raise ValueError(f"{len(data)} bytes, where a record with axes {letters} has {wanted}")
    amplifier = layout.amplifier_at
    return Record(
        int.from_bytes(data[layout.sample_at : layout.sample_at + 2], "little"),
        data[layout.error_at],
        0 if amplifier is None else int.from_bytes(data[amplifier : amplifier + 4], "little"),
        {
            letter: _axis(data, layout.axes_at + at * layout.axis_size)
            for at, letter in enumerate(letters)
        },
    )


def _axis(data: bytes, at: int) -> AxisRecord:
    status, switches, stop, reference, position, error, _, velocity, torque = _AXIS.unpack_from(
        data, at
    )
    return AxisRecord(
        status,
        switches,
        stop,
        reference,
        position,
        error,
        velocity * VELOCITY,
        torque * VOLTS,
    )
