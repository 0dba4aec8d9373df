"""Process data: dynamic mapping, transmission types, timers, SYNC (CiA 301, 7.2.2, 7.2.5, 14xx-1Axx)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from crtk_sim_backends.canopen.aborts import Abort, SdoAbort
from crtk_sim_backends.canopen.dictionary import DataType, Key, ObjectDictionary
from crtk_sim_backends.canopen.emcy import Emergency
from crtk_sim_backends.canopen.objects import NO_RTR, VALID

RECEIVE: Final = 0x1400
TRANSMIT: Final = 0x1800
MAPPING: Final = 0x200  # from the parameter to the mapping
LONGEST: Final = 64  # bits
_CYCLIC: Final = 240  # greatest transmission type that SYNC drives
_RESERVED_TYPES: Final = range(241, 254)  # 252 and 253 need remote frames, which this node ignores

DUMMIES: Final = {
    kind.number: kind
    for kind in (DataType.I8, DataType.I16, DataType.I32, DataType.U8, DataType.U16, DataType.U32)
}

PDO_TOO_SHORT: Final = 0x8210
PDO_TOO_LONG: Final = 0x8220
SYNC_LENGTH: Final = 0x8240
RPDO_TIMEOUT: Final = 0x8250
PARAMETER: Final = 0x6320


@dataclass
class Pdo:
    """One PDO that exists: how it is mapped, and where it stands."""

    index: int  # of the communication parameter
    identifier: int
    kind: int  # transmission type
    keys: list[Key | None]  # None for a dummy
    layout: struct.Struct
    readers: list[Callable[[], int]]  # of its values
    writers: list[Callable[[int], None]]  # of those of an RPDO
    inhibit: float  # s
    event: float  # s, 0 for none
    start: int  # SYNC counter with which the cycle begins, 0 for any
    received: bytes | None = None  # RPDO that waits for SYNC
    deadline: float | None = None  # RPDO: of the next one; TPDO: of the event timer
    syncs: int = 0  # since the last transmission
    started: bool = False
    sent: bytes | None = None
    allowed: float = 0.0  # end of the inhibit time
    held: bool = False  # TPDO that has changed and waits for that

    def __post_init__(self) -> None:
        self.plain = self.kind <= _CYCLIC


class ProcessData:
    """The RPDOs and TPDOs of a node.

    Args:
        dictionary: of the node; what an RPDO brings is stored in it.
        emergency: hears of PDOs that are wrong.
        operational: whether the node is OPERATIONAL.
        keeps_no_rtr: a COB-ID of a TPDO without bit 30 is refused.
    """

    def __init__(
        self,
        dictionary: ObjectDictionary,
        emergency: Emergency,
        operational: Callable[[], bool],
        *,
        keeps_no_rtr: bool = False,
    ) -> None:
        self._keeps_no_rtr = keeps_no_rtr
        self._dictionary = dictionary
        self._emergency = emergency
        self._operational = operational
        self.receiving: dict[int, Pdo] = {}
        self.transmitting: list[Pdo] = []
        self.synchronous: list[Pdo] = []  # of those that are transmitted
        self.event_driven: list[Pdo] = []
        self._sync_size = 0  # bytes of SYNC
        for base in (RECEIVE, TRANSMIT):
            for index in self._indices(base):
                dictionary.guards[index] = self._guard_parameter(index)
                dictionary.guards[index + MAPPING] = self._guard_mapping(index)
                dictionary.checks[index + MAPPING] = self._mapping_check(index)
                dictionary.written[index] = lambda sub: self.rebuild()
                dictionary.written[index + MAPPING] = lambda sub: self.rebuild()
        dictionary.guards[0x1005] = self._guard_sync
        dictionary.guards[0x1019] = self._guard_counter
        dictionary.written[0x1019] = lambda sub: self._note_counter()
        self.rebuild()

    # Configuration

    def _indices(self, base: int) -> list[int]:
        """Communication parameters of one direction that the node has."""
        objects = self._dictionary.objects
        every = range(base, base + MAPPING)
        return [index for index in every if index in objects and index + MAPPING in objects]

    def _exists(self, index: int) -> bool:
        return not self._dictionary[index, 1] & VALID

    def _guard_parameter(self, index: int) -> Callable[[int, int], None]:
        def guard(sub: int, value: int) -> None:
            exists = self._exists(index)
            if sub == 1:
                if exists and not value & VALID and (value ^ self._dictionary[index, 1]) & 0x7FF:
                    raise SdoAbort(Abort.VALUE)  # the COB-ID of a PDO in use
                if self._keeps_no_rtr and index >= TRANSMIT and not value & NO_RTR:
                    raise SdoAbort(Abort.VALUE)
                if not value & VALID and not _may_carry_pdo(value & 0x1FFF_FFFF):
                    raise SdoAbort(Abort.VALUE)
                return
            fixed = sub in (3, 6) and exists and value != self._dictionary[index, sub]
            if fixed or (sub == 2 and value in _RESERVED_TYPES):
                raise SdoAbort(Abort.VALUE)

        return guard

    def _guard_mapping(self, index: int) -> Callable[[int, int], None]:
        mapping = index + MAPPING

        def guard(sub: int, value: int) -> None:
            if self._operational():
                raise SdoAbort(Abort.DEVICE_STATE)
            if self._exists(index) or (sub and self._dictionary[mapping, 0]):
                raise SdoAbort(Abort.UNSUPPORTED_ACCESS)

        return guard

    def _mapping_check(self, index: int) -> Callable[[int, int], None]:
        mapping = index + MAPPING

        def check(sub: int, value: int) -> None:
            count = self._dictionary[mapping, 0] if sub else value
            if count and count not in self._dictionary.objects[mapping].entries:
                raise SdoAbort(Abort.PDO_LENGTH)
            if sub > count and value:
                self._check_mapped(value, index)
            entries = [
                value if entry == sub else self._dictionary[mapping, entry]
                for entry in range(1, count + 1)
            ]
            for entry in entries:
                self._check_mapped(entry, index)
            if sum(entry & 0xFF for entry in entries) > LONGEST:
                raise SdoAbort(Abort.PDO_LENGTH)

        return check

    def _check_mapped(self, entry: int, index: int) -> None:
        target, sub, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        direction = "t" if index >= TRANSMIT else "r"
        if direction == "r" and target in DUMMIES and not sub:
            permitted, size = True, DUMMIES[target].size
        else:
            variable = self._dictionary.variable(target, sub)
            permitted, size = direction in variable.pdo, variable.type.size
        if not permitted or bits != 8 * size:
            raise SdoAbort(Abort.NOT_MAPPABLE)

    def _guard_sync(self, sub: int, value: int) -> None:
        if value & 0x4000_0000 or value & 0x1FFF_FFFF > 0x7FF:
            raise SdoAbort(Abort.VALUE)  # this node produces no SYNC, and knows 11-bit identifiers

    def _guard_counter(self, sub: int, value: int) -> None:
        if value == 1:
            raise SdoAbort(Abort.VALUE)
        if self._dictionary[0x1006, 0]:
            raise SdoAbort(Abort.DEVICE_STATE)

    def rebuild(self) -> None:
        """Read the configuration anew; what waits is forgotten."""
        existing = filter(self._exists, self._indices(RECEIVE))
        self.receiving = {pdo.identifier: pdo for pdo in map(self._build, existing)}
        self.transmitting = [
            self._build(index) for index in self._indices(TRANSMIT) if self._exists(index)
        ]
        self.synchronous = [pdo for pdo in self.transmitting if pdo.kind <= _CYCLIC]
        self.event_driven = [pdo for pdo in self.transmitting if pdo.kind > _CYCLIC]
        self._note_counter()

    def _note_counter(self) -> None:
        self._sync_size = 1 if self._dictionary[0x1019, 0] else 0

    def _build(self, index: int) -> Pdo:
        od = self._dictionary
        keys: list[Key | None] = []
        layout = "<"
        for sub in range(1, od[index + MAPPING, 0] + 1):
            entry = od[index + MAPPING, sub]
            key = (entry >> 16, entry >> 8 & 0xFF)
            known = od.variables.get(key)
            layout += (known.type if known else DUMMIES[key[0]]).layout[1:]
            keys.append(key if known else None)
        return Pdo(
            index,
            od[index, 1] & 0x7FF,
            od[index, 2],
            keys,
            struct.Struct(layout),
            [od.reader(key) for key in keys if key is not None],
            [_ignore if key is None else od.writer(key) for key in keys],
            inhibit=od[index, 3] * 1e-4,
            event=od[index, 5] * 1e-3,
            start=od[index, 6] if index >= TRANSMIT else 0,
        )

    # Traffic

    def on_rpdo(self, pdo: Pdo, data: bytes, now: float) -> bool:
        """Take an RPDO; True when its values are now in the dictionary."""
        size = pdo.layout.size
        for code, wrong in ((PDO_TOO_SHORT, len(data) < size), (PDO_TOO_LONG, len(data) > size)):
            if wrong:
                self._emergency.begin(code, bytes((len(data), size)), pdo.index)
                pdo.plain = False  # the next right one ends the error
            else:
                self._emergency.end(code, pdo.index)
        if len(data) < size:
            return False
        if pdo.event:
            pdo.deadline = now + pdo.event
            self._emergency.end(RPDO_TIMEOUT, pdo.index)
        if pdo.kind <= _CYCLIC:
            pdo.received = data[:size]
            return False
        self._apply(pdo, data)
        return True

    def _apply(self, pdo: Pdo, data: bytes) -> None:
        for number, value in enumerate(pdo.layout.unpack_from(data)):
            try:
                pdo.writers[number](value)
            except SdoAbort:
                key = pdo.keys[number]
                assert key is not None  # a dummy takes everything
                self._emergency.once(PARAMETER, struct.pack("<HB", *key))

    def apply_received(self) -> bool:
        """Apply the synchronous RPDOs that have come since the last SYNC; whether there was one."""
        applied = False
        for pdo in self.receiving.values():
            if pdo.received is not None:
                data, pdo.received = pdo.received, None
                self._apply(pdo, data)
                applied = True
        return applied

    def check_sync(self, data: bytes) -> bool:
        """Whether a SYNC message has the length that 1019 asks for; reports it when not."""
        if len(data) == self._sync_size:
            self._emergency.end(SYNC_LENGTH)
            return True
        self._emergency.begin(SYNC_LENGTH, bytes((len(data), self._sync_size)))
        return False

    def on_sync(self, counter: int | None) -> list[tuple[int, bytes]]:
        """Sample and return the synchronous TPDOs of this SYNC."""
        frames = []
        for pdo in self.synchronous:
            if pdo.start and counter is not None and not pdo.started and counter != pdo.start:
                continue
            pdo.syncs = pdo.syncs + 1 if pdo.started or not pdo.start else max(1, pdo.kind)
            pdo.started = True
            data = self._pack(pdo)
            if pdo.syncs >= pdo.kind if pdo.kind else data != pdo.sent:
                pdo.syncs = 0
                pdo.sent = data
                frames.append((pdo.identifier, data))
        return frames

    def begin(self) -> None:
        """Begin, because the node has become OPERATIONAL: every event-driven TPDO is sent once."""
        for pdo in self.transmitting:
            pdo.sent, pdo.syncs, pdo.started = None, 0, False
            pdo.allowed, pdo.held, pdo.deadline = 0.0, False, None
        for pdo in self.receiving.values():
            pdo.received, pdo.deadline = None, None

    def on_events(self, now: float) -> list[tuple[int, bytes]]:
        """Event-driven TPDOs that have changed or whose event timer is over."""
        frames = []
        for pdo in self.event_driven:
            data = self._pack(pdo)
            pdo.held = now < pdo.allowed and data != pdo.sent
            if now < pdo.allowed:
                continue
            due = pdo.deadline is not None and now >= pdo.deadline
            if due or data != pdo.sent:
                began = pdo.deadline if due and pdo.deadline is not None else now
                pdo.sent = data
                pdo.allowed = now + pdo.inhibit
                pdo.deadline = max(now, began + pdo.event) if pdo.event else None
                frames.append((pdo.identifier, data))
        return frames

    def extend(self, seconds: float) -> None:
        """Let the deadlines of the RPDOs be later."""
        for pdo in self.receiving.values():
            if pdo.deadline is not None:
                pdo.deadline += seconds

    def check_deadlines(self, now: float) -> None:
        """Report the RPDOs that have stayed away for longer than their event timer."""
        for pdo in self.receiving.values():
            if pdo.deadline is not None and now >= pdo.deadline:
                pdo.deadline = None
                self._emergency.begin(RPDO_TIMEOUT, struct.pack("<H", pdo.index), pdo.index)

    def _pack(self, pdo: Pdo) -> bytes:
        data = pdo.layout.pack(*[read() for read in pdo.readers])
        return self._claimed(pdo, data) if self._dictionary.claims else data

    def _claimed(self, pdo: Pdo, data: bytes) -> bytes:
        """The data with what objects read as by a fault, cut or filled up to their size."""
        result, end = bytearray(data), 0
        for key in pdo.keys:
            assert key is not None  # a TPDO has no dummies
            start, end = end, end + self._dictionary.variables[key].type.size
            if key in self._dictionary.claims:
                claimed = self._dictionary.claims[key][: end - start]
                result[start:end] = claimed.ljust(end - start, b"\0")
        return bytes(result)

    @property
    def next_timer(self) -> float | None:
        """When a deadline, an event timer or an inhibit time ends, None for never."""
        times = [pdo.deadline for pdo in self.receiving.values() if pdo.deadline is not None]
        for pdo in self.event_driven:
            if pdo.deadline is not None:
                times.append(max(pdo.deadline, pdo.allowed))
            if pdo.held:
                times.append(pdo.allowed)
        return min(times, default=None)


def _ignore(value: int) -> None:
    """Take the value of a dummy."""


def _may_carry_pdo(identifier: int) -> bool:
    """Whether CiA 301 (table 39: restricted CAN-IDs) leaves the identifier to PDOs."""
    if identifier > 0x7FF or identifier <= 0x80:
        return False
    return not any(
        low <= identifier <= high
        for low, high in ((0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x7FF))
    )
