"""Object dictionary: typed objects with access rights, ranges and defaults (CiA 301, section 7.4)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Final, TypeAlias

from crtk_sim_backends.canopen.aborts import Abort, SdoAbort

Value: TypeAlias = int | bytes
Key: TypeAlias = tuple[int, int]  # index, sub-index


class DataType(Enum):
    """Type of an object: its number in an EDS, and its little-endian format ("" for bytes)."""

    BOOLEAN = (0x01, "<?")
    I8 = (0x02, "<b")
    I16 = (0x03, "<h")
    I32 = (0x04, "<i")
    U8 = (0x05, "<B")
    U16 = (0x06, "<H")
    U32 = (0x07, "<I")
    I64 = (0x15, "<q")
    U64 = (0x1B, "<Q")
    STRING = (0x09, "")
    OCTETS = (0x0A, "")
    DOMAIN = (0x0F, "")

    def __init__(self, number: int, layout: str) -> None:
        self.number = number
        self.layout = layout
        self.size = struct.calcsize(layout)  # bytes, 0 when it varies

    @property
    def limits(self) -> tuple[int, int]:
        """Least and greatest number of the type."""
        bits = 8 * self.size
        if self.layout.islower():
            return -(1 << bits - 1), (1 << bits - 1) - 1
        return 0, 1 if self is DataType.BOOLEAN else (1 << bits) - 1


class Kind(Enum):
    """Object code of CiA 301, table 42."""

    DOMAIN = 0x2
    VAR = 0x7
    ARRAY = 0x8
    RECORD = 0x9


@dataclass(frozen=True)
class OfNode:
    """A default that depends on the node-ID: ``$NODEID+offset`` in an EDS."""

    offset: int


@dataclass(frozen=True)
class Variable:
    """One entry.

    Attributes:
        name: as in the EDS.
        type: data type.
        access: "ro", "rw", "wo" or "const".
        default: value after a reset.
        low: least permitted value, None for that of the type.
        high: greatest permitted value, None for that of the type.
        pdo: "t" when it can be mapped into a TPDO, "r" into an RPDO, "rt" both, "" neither.
    """

    name: str
    type: DataType
    access: str = "ro"
    default: int | bytes | OfNode = 0
    low: int | None = None
    high: int | None = None
    pdo: str = ""

    def initial(self, node_id: int) -> Value:
        """Value after a reset of the node `node_id`."""
        if isinstance(self.default, OfNode):
            return self.default.offset + node_id
        if self.type.size == 0 and isinstance(self.default, int):
            return b""
        return self.default


@dataclass(frozen=True)
class Object:
    """One object: its entries by sub-index; a VAR has only sub-index 0."""

    index: int
    name: str
    kind: Kind
    entries: dict[int, Variable] = field(default_factory=dict)


LONGEST_DOMAIN: Final = 1 << 16  # bytes that a download may have


class ObjectDictionary:
    """The values of a node, and the rules by which others reach them.

    `read` and `write` are the way in from the bus: they check, and raise :class:`SdoAbort`.
    `force` is that of a test: past access rights and states, but with values of use to the device.
    `[key]` is the way in from the inside of the device: no rule applies.

    Args:
        objects: what exists.
        node_id: for the defaults that depend on it.
        hidden: what the inside of the device has besides, and nobody can reach.
    """

    def __init__(
        self, objects: Iterable[Object], node_id: int, hidden: Iterable[Object] = ()
    ) -> None:
        self.objects: dict[int, Object] = {entry.index: entry for entry in objects}
        self.node_id = node_id
        self.variables: dict[Key, Variable] = {
            (entry.index, sub): variable
            for entry in (*hidden, *self.objects.values())
            for sub, variable in entry.entries.items()
        }
        self._ranges = {key: _range(variable) for key, variable in self.variables.items()}
        self.values: dict[Key, Value] = {}
        self.stored: dict[Key, Value] = {}  # by 1010, over the defaults
        self.live: dict[Key, Callable[[], Value]] = {}  # values that are computed when read
        self.guards: dict[int, Callable[[int, int], None]] = {}  # (sub, value): permitted now
        self.checks: dict[
            int, Callable[[int, int], None]
        ] = {}  # (sub, value): of use to the device
        self.claims: dict[Key, bytes] = {}  # fault: what these read as, whatever they hold
        self.ignored: set[int] = set()  # fault: writes to these are accepted and have no effect
        self.written: dict[int, Callable[[int], None]] = {}  # (sub) after a write
        self.reset(self.variables)

    def reset(self, keys: Iterable[Key]) -> None:
        """Give the entries their stored values or their defaults."""
        for key in list(keys):
            value = self.variables[key].initial(self.node_id)
            self.values[key] = self.stored.get(key, value)

    def keys_within(self, first: int, last: int) -> Iterator[Key]:
        """Keys of the objects `first` to `last`, both included."""
        return (key for key in self.variables if first <= key[0] <= last)

    def __getitem__(self, key: Key) -> int:
        live = self.live.get(key)
        return live() if live else self.values[key]  # type: ignore[return-value]

    def __setitem__(self, key: Key, value: int) -> None:
        self.values[key] = value

    def reader(self, key: Key) -> Callable[[], int]:
        """Make what reads a number as `[key]` does, for those who read it again and again."""
        live = self.live.get(key)
        return partial(self.values.__getitem__, key) if live is None else live  # type: ignore[return-value]

    def variable(self, index: int, sub: int) -> Variable:
        """Find an entry.

        Raises:
            SdoAbort: NO_OBJECT or NO_SUBINDEX.
        """
        known = self.objects.get(index)
        if known is None:
            raise SdoAbort(Abort.NO_OBJECT)
        if sub not in known.entries:
            raise SdoAbort(Abort.NO_SUBINDEX)
        return known.entries[sub]

    def read(self, index: int, sub: int) -> bytes:
        """Read an entry as bytes.

        Raises:
            SdoAbort: the entry does not exist, is write-only or has no data.
        """
        variable = self.variable(index, sub)
        if variable.access == "wo":
            raise SdoAbort(Abort.WRITE_ONLY)
        if (index, sub) in self.claims:
            return self.claims[index, sub]
        live = self.live.get((index, sub))
        value = live() if live else self.values[index, sub]
        if isinstance(value, bytes):
            return value
        return struct.pack(variable.type.layout, value)

    def check_writable(self, index: int, sub: int, size: int | None) -> Variable:
        """Find an entry that may be written with `size` bytes (None: not known yet).

        Raises:
            SdoAbort: it does not exist, is read-only or has another size.
        """
        variable = self.variable(index, sub)
        if variable.access in ("ro", "const"):
            raise SdoAbort(Abort.READ_ONLY)
        if size is None:
            return variable
        if variable.type.size == 0:
            if size > LONGEST_DOMAIN:
                raise SdoAbort(Abort.MEMORY)
        elif size != variable.type.size:
            raise SdoAbort(Abort.TOO_LONG if size > variable.type.size else Abort.TOO_SHORT)
        return variable

    def write(self, index: int, sub: int, data: bytes) -> None:
        """Write an entry from bytes.

        Raises:
            SdoAbort: the access, the size or the value is not permitted.
        """
        variable = self.check_writable(index, sub, len(data))
        if variable.type.size == 0:
            self.values[index, sub] = data
        else:
            (value,) = struct.unpack(variable.type.layout, data)
            self.store(index, sub, int(value))

    def store(self, index: int, sub: int, value: int) -> None:
        """Write a number that has the right size.

        Raises:
            SdoAbort: it is out of range, or not permitted now.
        """
        self.writer((index, sub))(value)

    def range_of(self, key: Key) -> tuple[int, int]:
        """Least and greatest value that an entry may have."""
        return self._ranges[key]

    def force(self, index: int, sub: int, value: int) -> None:
        """Write a number whatever its access, and whatever the device does.

        Raises:
            SdoAbort: there is no such entry, or it can have no such value; nothing has changed.
        """
        self.variable(index, sub)
        key, (low, high) = (index, sub), self._ranges[index, sub]
        if value > high:
            raise SdoAbort(Abort.VALUE_HIGH)
        if value < low:
            raise SdoAbort(Abort.VALUE_LOW)
        if check := self.checks.get(index):
            check(sub, value)
        self.values[key] = value
        if written := self.written.get(index):
            written(sub)

    def writer(self, key: Key) -> Callable[[int], None]:
        """Make what writes a number as `store` does, for those who write it again and again."""
        index, sub = key
        low, high = self._ranges[key]
        guard, written = self.guards.get(index), self.written.get(index)
        check = self.checks.get(index)
        values, ignored = self.values, self.ignored

        def write(value: int) -> None:
            if value > high:
                raise SdoAbort(Abort.VALUE_HIGH)
            if value < low:
                raise SdoAbort(Abort.VALUE_LOW)
            if guard is not None:
                guard(sub, value)
            if check is not None:
                check(sub, value)
            if index in ignored:
                return
            values[key] = value
            if written is not None:
                written(sub)

        return write


def _range(variable: Variable) -> tuple[int, int]:
    """Least and greatest permitted value; 0 for what is no number."""
    low, high = variable.type.limits if variable.type.size else (0, 0)
    return (
        low if variable.low is None else variable.low,
        high if variable.high is None else variable.high,
    )
