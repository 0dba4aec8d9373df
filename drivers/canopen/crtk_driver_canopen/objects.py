"""Objects of CiA 301 and CiA 402 that the driver uses, with their types: the one place for an index."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType
from typing import Final, NamedTuple

from typing_extensions import override

from crtk_drivers.errors.near_names import near_names

AXIS_STEP: Final = 0x800
"""Distance between the objects of two axes of one node (CiA 402-2, multi-axis)."""

_PROFILE: Final = range(0x6000, 0xA000)


class _Coding(NamedTuple):
    code: int
    format: str
    bits: int


class ObjectType(Enum):
    """Data types (CiA 301, 7.4.7): the number in a dictionary, the struct format, the size in bits.

    Text and data of any length have no format and no size.
    """

    BOOL = _Coding(0x01, "?", 8)
    I8 = _Coding(0x02, "b", 8)
    I16 = _Coding(0x03, "h", 16)
    I32 = _Coding(0x04, "i", 32)
    U8 = _Coding(0x05, "B", 8)
    U16 = _Coding(0x06, "H", 16)
    U32 = _Coding(0x07, "I", 32)
    F32 = _Coding(0x08, "f", 32)
    TEXT = _Coding(0x09, "", 0)
    BYTES = _Coding(0x0A, "", 0)
    DOMAIN = _Coding(0x0F, "", 0)
    F64 = _Coding(0x11, "d", 64)
    I64 = _Coding(0x15, "q", 64)
    U64 = _Coding(0x1B, "Q", 64)

    @property
    def format(self) -> str:
        """Format for `struct`, without byte order; empty for text and data."""
        return self.value.format

    @property
    def bits(self) -> int:
        """Size in bits; 0 for text and data."""
        return self.value.bits

    def pack(self, value: float | str | bytes) -> bytes:
        """Return the bytes of a value.

        Raises:
            ValueError: it does not fit.
        """
        if isinstance(value, str):
            value = value.encode()
        if not self.format:
            if not isinstance(value, bytes):
                raise ValueError(f"{value!r} is no {self.name.lower()}")
            return value
        try:
            return struct.pack(f"<{self.format}", value)
        except struct.error as error:
            raise ValueError(f"{value!r} does not fit into {self.name.lower()}: {error}") from error

    def unpack(self, data: bytes) -> int | float | str | bytes:
        """Return the value of bytes; text without its trailing zeros.

        Raises:
            ValueError: too few bytes.
        """
        if self is ObjectType.TEXT:
            return data.rstrip(b"\0").decode("utf-8", errors="replace")
        if not self.format:
            return data
        size = self.bits // 8
        if len(data) < size:
            raise ValueError(f"{len(data)} bytes for {self.name.lower()}, which has {size}")
        value: int | float = struct.unpack_from(f"<{self.format}", data)[0]
        return value


_BY_CODE: Final = {kind.value.code: kind for kind in ObjectType}


def object_type(code: int) -> ObjectType:
    """Return the type with this number in an object dictionary; data for one that is not known."""
    return _BY_CODE.get(code, ObjectType.BYTES)


@dataclass(frozen=True, slots=True)
class Entry:
    """One object with a value: index, sub-index, type and name."""

    index: int
    sub: int
    type: ObjectType
    name: str

    def on_axis(self, axis: int) -> Entry:
        """Return the same object of another axis of a node; objects of the node itself stay the same."""
        if self.index not in _PROFILE:
            return self
        return replace(self, index=self.index + AXIS_STEP * axis)

    @property
    def mapping(self) -> int:
        """The entry of a PDO mapping that stands for it: index, sub-index and length in bits."""
        return self.index << 16 | self.sub << 8 | self.type.bits

    @override
    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.sub:02X} {self.name}"


_T = ObjectType

OBJECTS: Final[Mapping[str, Entry]] = MappingProxyType(
    {
        row[3].replace(" ", "_"): Entry(*row)
        for row in (
            (0x1000, 0, _T.U32, "device type"),
            (0x1001, 0, _T.U8, "error register"),
            (0x1003, 0, _T.U8, "number of errors"),
            (0x1005, 0, _T.U32, "sync cob id"),
            (0x1006, 0, _T.U32, "communication cycle period"),
            (0x1008, 0, _T.TEXT, "device name"),
            (0x1009, 0, _T.TEXT, "hardware version"),
            (0x100A, 0, _T.TEXT, "software version"),
            (0x1010, 1, _T.U32, "store parameters"),
            (0x1011, 1, _T.U32, "restore parameters"),
            (0x1014, 0, _T.U32, "emergency cob id"),
            (0x1016, 0, _T.U8, "consumer heartbeat entries"),
            (0x1016, 1, _T.U32, "consumer heartbeat time"),
            (0x1017, 0, _T.U16, "producer heartbeat time"),
            (0x1018, 1, _T.U32, "vendor id"),
            (0x1018, 2, _T.U32, "product code"),
            (0x1018, 3, _T.U32, "revision number"),
            (0x1018, 4, _T.U32, "serial number"),
            (0x1019, 0, _T.U8, "synchronous counter overflow"),
            (0x1029, 1, _T.U8, "error behaviour"),
            (0x6007, 0, _T.I16, "abort connection option"),
            (0x603F, 0, _T.U16, "error code"),
            (0x6040, 0, _T.U16, "controlword"),
            (0x6041, 0, _T.U16, "statusword"),
            (0x605A, 0, _T.I16, "quick stop option"),
            (0x605B, 0, _T.I16, "shutdown option"),
            (0x605C, 0, _T.I16, "disable operation option"),
            (0x605D, 0, _T.I16, "halt option"),
            (0x605E, 0, _T.I16, "fault reaction option"),
            (0x6060, 0, _T.I8, "mode of operation"),
            (0x6061, 0, _T.I8, "mode of operation display"),
            (0x6062, 0, _T.I32, "position demand"),
            (0x6064, 0, _T.I32, "position actual"),
            (0x6065, 0, _T.U32, "following error window"),
            (0x6066, 0, _T.U16, "following error time"),
            (0x6067, 0, _T.U32, "position window"),
            (0x6068, 0, _T.U16, "position window time"),
            (0x606B, 0, _T.I32, "velocity demand"),
            (0x606C, 0, _T.I32, "velocity actual"),
            (0x6071, 0, _T.I16, "target torque"),
            (0x6072, 0, _T.U16, "max torque"),
            (0x6075, 0, _T.U32, "motor rated current"),
            (0x6076, 0, _T.U32, "motor rated torque"),
            (0x6077, 0, _T.I16, "torque actual"),
            (0x607A, 0, _T.I32, "target position"),
            (0x607C, 0, _T.I32, "home offset"),
            (0x607D, 1, _T.I32, "min position limit"),
            (0x607D, 2, _T.I32, "max position limit"),
            (0x607F, 0, _T.U32, "max profile velocity"),
            (0x6080, 0, _T.U32, "max motor speed"),
            (0x6081, 0, _T.U32, "profile velocity"),
            (0x6083, 0, _T.U32, "profile acceleration"),
            (0x6084, 0, _T.U32, "profile deceleration"),
            (0x6085, 0, _T.U32, "quick stop deceleration"),
            (0x6086, 0, _T.I16, "motion profile type"),
            (0x6087, 0, _T.U32, "torque slope"),
            (0x608F, 1, _T.U32, "encoder increments"),
            (0x608F, 2, _T.U32, "encoder motor revolutions"),
            (0x6091, 1, _T.U32, "gear motor revolutions"),
            (0x6091, 2, _T.U32, "gear shaft revolutions"),
            (0x6092, 1, _T.U32, "feed"),
            (0x6092, 2, _T.U32, "feed shaft revolutions"),
            (0x6096, 1, _T.U32, "velocity factor numerator"),
            (0x6096, 2, _T.U32, "velocity factor divisor"),
            (0x6098, 0, _T.I8, "homing method"),
            (0x6099, 1, _T.U32, "homing speed switch"),
            (0x6099, 2, _T.U32, "homing speed zero"),
            (0x609A, 0, _T.U32, "homing acceleration"),
            (0x60A8, 0, _T.U32, "si unit position"),
            (0x60A9, 0, _T.U32, "si unit velocity"),
            (0x60AA, 0, _T.U32, "si unit acceleration"),
            (0x60B0, 0, _T.I32, "position offset"),
            (0x60B1, 0, _T.I32, "velocity offset"),
            (0x60B2, 0, _T.I16, "torque offset"),
            (0x60C1, 1, _T.I32, "interpolation position"),
            (0x60C2, 1, _T.U8, "interpolation period value"),
            (0x60C2, 2, _T.I8, "interpolation period exponent"),
            (0x60C5, 0, _T.U32, "max acceleration"),
            (0x60C6, 0, _T.U32, "max deceleration"),
            (0x60F4, 0, _T.I32, "following error actual"),
            (0x60FD, 0, _T.U32, "digital inputs"),
            (0x60FE, 1, _T.U32, "digital outputs"),
            (0x60FF, 0, _T.I32, "target velocity"),
            (0x6502, 0, _T.U32, "supported drive modes"),
        )
    }
)
"""By name with underscores (CiA 301 and CiA 402-2, object dictionaries)."""

_NUMBER: Final = re.compile(
    r"(0x)?(?P<index>[0-9a-f]{4})h?(:(0x)?(?P<sub>[0-9a-f]{1,2})h?)?", re.IGNORECASE
)

_NAMES: Final = {(entry.index, entry.sub): entry.name for entry in OBJECTS.values()}


def first_axis(index: int) -> int:
    """Return the index that an object has on the first axis of a node."""
    return _PROFILE.start + (index - _PROFILE.start) % AXIS_STEP if index in _PROFILE else index


def object_text(index: int, sub: int) -> str:
    """Return an object for people: ``6064h:00 position actual``, with its axis if it is not the first."""
    number = f"{index:04X}h:{sub:02X}"
    first = first_axis(index)
    axis = (index - first) // AXIS_STEP
    name = _NAMES.get((first, sub), "")
    if not name:
        return number
    return f"{number} {name} of axis {axis}" if axis else f"{number} {name}"


_COMMANDS: Final = frozenset(
    {0x1010, 0x1011, *range(0x1F50, 0x1F58)}
    | {0x6040, 0x6042, 0x6060, 0x6071, 0x607A, 0x6098, 0x60FF}
    | {0x60B0, 0x60B1, 0x60B2, 0x60C1, 0x60FE}
)
"""Objects that make a drive do something: store, restore, be programmed, get power, move, free its brake."""


def is_command(index: int) -> bool:
    """Whether an object moves or powers a drive, or changes what it has stored: no file may say that."""
    return first_axis(index) in _COMMANDS


def parse_object(text: str) -> tuple[int, int]:
    """Return index and sub-index of a text such as ``6064``, ``0x6064:0``, ``1018:4`` or ``position_actual``.

    Numbers are hexadecimal, as they are everywhere in CANopen.

    Raises:
        ValueError: it is neither, with what was probably meant.
    """
    name = text.strip().lower().replace(" ", "_").replace("-", "_")
    if name in OBJECTS:
        entry = OBJECTS[name]
        return entry.index, entry.sub
    found = _NUMBER.fullmatch(text.strip())
    if found is None:
        close = near_names(name, OBJECTS)
        hint = (
            f"did you mean {close[0]!r}?" if close else "give INDEX[:SUB] in hexadecimal, or a name"
        )
        raise ValueError(f"{text!r} is no object: {hint}")
    return int(found["index"], 16), int(found["sub"] or "0", 16)
