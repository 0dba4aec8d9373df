"""PDOs as data: what is in them, how they are packed, and how a node is made to have them.

A `Pdo` says what one frame carries; `PdoGroup` packs and unpacks all frames of a cycle with one
precompiled struct; `configure` writes one into a node in the order of CiA 301 (7.5.2.36), and reads it back.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType
from typing import Final, NamedTuple

from typing_extensions import override

from crtk_driver_canopen.objects import Entry, ObjectType, object_text
from crtk_driver_canopen.sdo import MISSING, Sdo, SdoAborted, abort_text
from crtk_drivers.errors import ConfigError, DeviceError, ProtocolError


class Direction(StrEnum):
    """Of a PDO, as the node sees it."""

    RECEIVE = "RPDO"
    TRANSMIT = "TPDO"


class _Place(NamedTuple):
    communication: int
    mapping: int
    cob_ids: tuple[int, ...]


PREDEFINED: Final[Mapping[Direction, _Place]] = MappingProxyType(
    {
        Direction.RECEIVE: _Place(0x1400, 0x1600, (0x200, 0x300, 0x400, 0x500)),
        Direction.TRANSMIT: _Place(0x1800, 0x1A00, (0x180, 0x280, 0x380, 0x480)),
    }
)
"""First communication and mapping object, and the COB-IDs of PDO 1 to 4 of node 0 (CiA 301, 7.3.5)."""

MOST_PDOS: Final = 512
"""PDOs of one direction that a node can have."""

SYNCHRONOUS: Final = range(241)
"""Transmission types that go with SYNC."""

_NOT_VALID: Final = 1 << 31
_NO_RTR: Final = 1 << 30
_EXTENDED: Final = 1 << 29
_ID: Final = 0x7FF
_NO_MAPPING: Final = MISSING | {0x06040041}
"""Abort codes of a mapping that say that the object is not there, or cannot be mapped."""


def default_cob_id(direction: Direction, number: int, node: int) -> int:
    """Return the COB-ID of the predefined connection set.

    Raises:
        ValueError: it has none for this number.
    """
    cob_ids = PREDEFINED[direction].cob_ids
    if not 1 <= number <= len(cob_ids):
        raise ValueError(f"{direction} {number} has no predefined COB-ID: give one")
    return cob_ids[number - 1] + node


@dataclass(frozen=True)
class Pdo:
    """One PDO of one node.

    Attributes:
        node: its id.
        direction: as the node sees it.
        number: from 1.
        entries: what it carries, in this order; whole bytes, 8 in all at most.
        transmission: type: 0 acyclic synchronous, n at every n-th SYNC, 254 and 255 by event.
        cob_id: None for that of the predefined connection set.
        inhibit: least time between two by event, in units of 100 µs.
        event_timer: longest time between two by event, in ms; 0: none.

    Raises:
        ValueError: what is asked for is not possible.
    """

    node: int
    direction: Direction
    number: int
    entries: tuple[Entry, ...]
    transmission: int = 1
    cob_id: int | None = None
    inhibit: int = 0
    event_timer: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.node <= 127:
            raise ValueError(f"node {self.node}: ids are 1 to 127")
        if not 1 <= self.number <= MOST_PDOS:
            raise ValueError(f"{self}: numbers are 1 to {MOST_PDOS}")
        if not self.entries or not all(entry.type.format for entry in self.entries):
            raise ValueError(f"{self}: needs objects of a fixed size")
        if self.size > 8:
            names = ", ".join(f"{entry.name} ({entry.type.bits // 8})" for entry in self.entries)
            raise ValueError(f"{self}: {self.size} bytes do not fit into 8: {names}")
        if not 1 <= self.id <= _ID:
            raise ValueError(f"{self}: COB-ID 0x{self.id:x} has more than 11 bits")

    @override
    def __str__(self) -> str:
        return f"node {self.node} {self.direction} {self.number}"

    @cached_property
    def id(self) -> int:
        """The COB-ID of its frames."""
        if self.cob_id is not None:
            return self.cob_id
        return default_cob_id(self.direction, self.number, self.node)

    @cached_property
    def format(self) -> str:
        """Format for `struct`, without byte order."""
        return "".join(entry.type.format for entry in self.entries)

    @cached_property
    def struct(self) -> struct.Struct:
        """Packs its values."""
        return struct.Struct(f"<{self.format}")

    @property
    def size(self) -> int:
        """Bytes of data in a frame."""
        return self.struct.size

    @property
    def synchronous(self) -> bool:
        """Whether it goes with SYNC."""
        return self.transmission in SYNCHRONOUS

    @property
    def communication(self) -> int:
        """Index of its communication parameters."""
        return PREDEFINED[self.direction].communication + self.number - 1

    @property
    def mapping(self) -> int:
        """Index of its mapping."""
        return PREDEFINED[self.direction].mapping + self.number - 1

    def pack(self, *values: float) -> bytes:
        """Return the data of a frame.

        Raises:
            struct.error: a value does not fit.
        """
        return self.struct.pack(*values)

    def unpack(self, data: bytes) -> tuple[int, ...]:
        """Return the values of a frame; what is beyond them is ignored, as CiA 301 has it.

        Raises:
            ProtocolError: too few bytes.
        """
        if len(data) < self.size:
            raise ProtocolError(
                f"{self}: {len(data)} bytes, where {self.size} are mapped",
                remedy="Another program has changed the mapping, or two nodes have one id.",
            )
        return self.struct.unpack_from(data)


class PdoGroup:
    """All PDOs that go one way in a cycle, packed by one struct.

    Args:
        pdos: in the order in which they are sent, or found again in `unpack`.

    Raises:
        ValueError: two have one COB-ID.
    """

    def __init__(self, pdos: Iterable[Pdo]) -> None:
        self.pdos = tuple(pdos)
        self.slots: Mapping[int, int] = {pdo.id: slot for slot, pdo in enumerate(self.pdos)}
        if len(self.slots) != len(self.pdos):
            twice = {pdo.id for pdo in self.pdos if self.pdos[self.slots[pdo.id]] is not pdo}
            raise ValueError(f"two PDOs have one COB-ID: {', '.join(map(hex, sorted(twice)))}")
        self._struct = struct.Struct("<" + "".join(pdo.format for pdo in self.pdos))
        ends = [0]
        for pdo in self.pdos:
            ends.append(ends[-1] + pdo.size)
        self._parts = tuple(slice(begin, end) for begin, end in pairwise(ends))
        self.sizes = tuple(pdo.size for pdo in self.pdos)

    def __len__(self) -> int:
        return len(self.pdos)

    def pack(self, values: Sequence[float]) -> list[bytes]:
        """Return the data of all frames.

        Args:
            values: of all entries of all PDOs, in order.

        Raises:
            struct.error: a value does not fit, or there are too few or too many.
        """
        data = self._struct.pack(*values)
        return [data[part] for part in self._parts]

    def unpack(self, frames: Sequence[bytes]) -> tuple[int, ...]:
        """Return the values of all entries of all PDOs, in order.

        Args:
            frames: data of each PDO, of exactly its `size`.

        Raises:
            struct.error: the data have another length in all.
        """
        return self._struct.unpack(b"".join(frames))

    def places(self, entry: Entry) -> dict[tuple[int, int], int]:
        """Return where an object's values are, by node and axis: positions in the values of `unpack`."""
        found: dict[tuple[int, int], int] = {}
        place = 0
        for pdo in self.pdos:
            for mapped in pdo.entries:
                for axis in range(8):
                    if mapped == entry.on_axis(axis):
                        found.setdefault((pdo.node, axis), place)
                        break
                place += 1
        return found


class PdoMismatch(DeviceError):
    """A node does not hold the PDO that was written into it."""


class NotMapped(SdoAborted):
    """A node lacks an object, or does not let it be in a PDO.

    Attributes:
        entry: the object, of its axis.
    """

    def __init__(self, pdo: Pdo, entry: Entry, error: SdoAborted) -> None:
        super().__init__(
            f"{entry} cannot be in {pdo}: {abort_text(error.code)} (abort 0x{error.code:08x})",
            where=error.where,
            remedy="This driver needs it in a PDO. Check in the manual of the drive what can be mapped.",
            code=error.code,
        )
        self.entry = entry


class _Parameter(NamedTuple):
    """One value of a PDO's parameters, and what it should be."""

    entry: Entry
    wanted: int
    mask: int = 0xFFFFFFFF


def _u(index: int, sub: int, kind: ObjectType, name: str) -> Entry:
    return Entry(index, sub, kind, name)


def _cob_id(pdo: Pdo) -> Entry:
    return _u(pdo.communication, 1, ObjectType.U32, f"COB-ID of {pdo.direction} {pdo.number}")


def _count(pdo: Pdo) -> Entry:
    name = f"number of objects in {pdo.direction} {pdo.number}"
    return _u(pdo.mapping, 0, ObjectType.U8, name)


def _mapped(pdo: Pdo) -> list[_Parameter]:
    return [
        _Parameter(
            _u(pdo.mapping, sub, ObjectType.U32, f"object {sub} in {pdo.direction} {pdo.number}"),
            entry.mapping,
        )
        for sub, entry in enumerate(pdo.entries, start=1)
    ]


def _timing(pdo: Pdo) -> list[_Parameter]:
    kind = _u(pdo.communication, 2, ObjectType.U8, f"type of {pdo.direction} {pdo.number}")
    rows = [_Parameter(kind, pdo.transmission)]
    if pdo.direction is Direction.TRANSMIT:
        inhibit = _u(pdo.communication, 3, ObjectType.U16, f"inhibit time of TPDO {pdo.number}")
        timer = _u(pdo.communication, 5, ObjectType.U16, f"event timer of TPDO {pdo.number}")
        rows += [_Parameter(inhibit, pdo.inhibit), _Parameter(timer, pdo.event_timer)]
    return rows


def _enabled(pdo: Pdo) -> _Parameter:
    return _Parameter(_cob_id(pdo), pdo.id, _NOT_VALID | _ID)


def read_back(sdo: Sdo, pdo: Pdo) -> list[str]:
    """Return how the node's PDO differs from `pdo`, in words; empty if it does not.

    An inhibit time or event timer that the node does not have counts as 0.

    Raises:
        SdoAborted, SdoSilent, ProtocolError: it could not be read.
    """
    count = _Parameter(_count(pdo), len(pdo.entries))
    rows = [_enabled(pdo), *_timing(pdo), count, *_mapped(pdo)]
    differences = []
    for row in rows:
        optional = row.entry.index == pdo.communication and row.entry.sub > 2
        found = (sdo.find(row.entry) or 0) if optional else sdo.read(row.entry)
        if found & row.mask != row.wanted:
            differences.append(
                f"{row.entry}: wanted {_shown(row, row.wanted)}, found {_shown(row, found)}"
            )
            if row is count:
                break
    return differences


def _shown(row: _Parameter, value: int) -> str:
    if row.entry.type is not ObjectType.U32:
        return str(value)
    if row.entry.sub == 1 and row.mask != 0xFFFFFFFF:
        return f"0x{value:08x}" + (" (not valid)" if value & _NOT_VALID else "")
    return f"0x{value:08x} ({object_text(value >> 16, value >> 8 & 0xFF)}, {value & 0xFF} bit)"


def configure(sdo: Sdo, pdo: Pdo) -> bool:
    """Make the node have `pdo`, and read it back. Nothing is written to a node that has it already.

    The node must be pre-operational. Order: not valid, no objects, objects, their number, type and
    times, valid.

    Returns:
        Whether anything was written.

    Raises:
        PdoMismatch: the node acknowledged the PDO and holds another one.
        NotMapped: an object cannot be in it.
        SdoAborted, SdoSilent, ProtocolError: it could not be read or written.
    """
    if not read_back(sdo, pdo):
        return False
    disable(sdo, pdo.node, pdo.direction, pdo.number, always=True)
    sdo.write(_count(pdo), 0)
    for row, entry in zip(_mapped(pdo), pdo.entries, strict=True):
        try:
            sdo.write(row.entry, row.wanted)
        except SdoAborted as error:
            if error.code in _NO_MAPPING:
                raise NotMapped(pdo, entry, error) from error
            raise
    sdo.write(_count(pdo), len(pdo.entries))
    for row in _timing(pdo):
        if row.entry.sub > 2 and (sdo.find(row.entry) or 0) == row.wanted:
            continue
        sdo.write(row.entry, row.wanted)
    no_rtr = _NO_RTR if pdo.direction is Direction.TRANSMIT else 0
    sdo.write(_cob_id(pdo), pdo.id | no_rtr)
    differences = read_back(sdo, pdo)
    if differences:
        raise PdoMismatch(
            f"{pdo} was written, but: {'; '.join(differences)}",
            where=sdo.where,
            remedy="Map only what the drive's manual allows in this PDO, or use another number.",
        )
    return True


def set_deadline(sdo: Sdo, pdo: Pdo, milliseconds: int) -> bool:
    """Set the time within which an RPDO must come (14xxh:5), where the node watches it, and read it back.

    Args:
        milliseconds: after it an emergency message tells that it did not come; 0: it is not watched.

    Returns:
        Whether the node has such a deadline.

    Raises:
        ObjectIgnored: the node acknowledged it and holds another one.
        SdoAborted, SdoSilent, ProtocolError: it could not be read or written.
    """
    entry = _u(pdo.communication, 5, ObjectType.U16, f"deadline of {pdo.direction} {pdo.number}")
    if sdo.find(entry) is None:
        return False
    sdo.ensure(entry, milliseconds)
    return True


def disable(
    sdo: Sdo, node: int, direction: Direction, number: int, *, always: bool = False
) -> bool:
    """Make a PDO of the node not valid, if it has it and it is valid; return whether it has it.

    Args:
        always: write even if it is not valid already.

    Raises:
        SdoAborted, SdoSilent, ProtocolError: it could not be read or written.
    """
    index = PREDEFINED[direction].communication + number - 1
    entry = _u(index, 1, ObjectType.U32, f"COB-ID of {direction} {number}")
    try:
        found = sdo.read(entry)
    except SdoAborted as error:
        if error.code in MISSING and not always:
            return False
        raise
    if always or not found & _NOT_VALID:
        sdo.write(entry, found | _NOT_VALID)
    return True


class _Reserved(NamedTuple):
    first: int
    last: int
    use: str


RESERVED: Final = (
    _Reserved(0x000, 0x000, "NMT commands"),
    _Reserved(0x001, 0x07F, "what CiA 301 keeps for itself"),
    _Reserved(0x080, 0x080, "SYNC"),
    _Reserved(0x081, 0x0FF, "emergencies"),
    _Reserved(0x100, 0x100, "the time"),
    _Reserved(0x101, 0x180, "what CiA 301 keeps for itself"),
    _Reserved(0x581, 0x5FF, "SDO answers"),
    _Reserved(0x601, 0x67F, "SDO requests"),
    _Reserved(0x6E0, 0x6FF, "what CiA 301 keeps for itself"),
    _Reserved(0x701, 0x77F, "heartbeats"),
    _Reserved(0x780, 0x7FF, "what CiA 301 keeps for itself"),
)
"""COB-IDs that no PDO may have (CiA 301, restricted CAN-IDs, and those of other services in use here)."""


def check_cob_ids(pdos: Iterable[Pdo]) -> None:
    """Refuse COB-IDs that two PDOs share, or that belong to something else.

    Raises:
        ConfigError: naming the PDOs, and what the COB-ID is for.
    """
    taken: dict[int, Pdo] = {}
    remedy = (
        "Change `rpdo_cob_ids` or `tpdo_cob_ids`; the COB-IDs 681h to 6DFh are free on most buses."
    )
    for pdo in pdos:
        for row in RESERVED:
            if row.first <= pdo.id <= row.last:
                raise ConfigError(
                    f"{pdo} cannot have the COB-ID 0x{pdo.id:x}: 0x{row.first:x} to 0x{row.last:x} are for "
                    f"{row.use}",
                    remedy=remedy,
                )
        other = taken.setdefault(pdo.id, pdo)
        if other is not pdo:
            raise ConfigError(f"{other} and {pdo} have one COB-ID, 0x{pdo.id:x}", remedy=remedy)


def read_cob_id(sdo: Sdo, direction: Direction, number: int) -> int:
    """Return the COB-ID that a node has for one of its PDOs, whether that is valid or not.

    Raises:
        DeviceError: it has none, or one of 29 bits.
        SdoAborted, SdoSilent, ProtocolError: it could not be read.
    """
    index = PREDEFINED[direction].communication + number - 1
    entry = _u(index, 1, ObjectType.U32, f"COB-ID of {direction} {number}")
    found = sdo.read(entry)
    if found & _EXTENDED or not found & _ID:
        raise DeviceError(
            f"{entry}: 0x{found:08x} is no COB-ID of 11 bits",
            where=sdo.where,
            remedy="Give the COB-IDs of this joint as a list.",
        )
    return found & _ID
