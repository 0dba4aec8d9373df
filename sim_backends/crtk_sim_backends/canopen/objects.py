"""Which objects a simulated drive has: CiA 301 communication, CiA 402 axes, a few of the vendor.

Defaults are those of a drive on which nobody has set anything yet: positions in counts of the
encoder, 65536 a revolution.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

from crtk_sim_backends.canopen.dictionary import DataType, Kind, Object, OfNode, Variable

I8, I16, I32 = DataType.I8, DataType.I16, DataType.I32
U8, U16, U32 = DataType.U8, DataType.U16, DataType.U32
STRING, DOMAIN = DataType.STRING, DataType.DOMAIN

PDOS: Final = 4  # of each direction, those of the predefined connection set
MOST_PDOS: Final = 16
MAPPED: Final = 8  # entries of a mapping
ERRORS_KEPT: Final = 8
AXIS_STRIDE: Final = 0x800  # between the objects of two axes (CiA 402-2)
MOST_AXES: Final = 8
COUNTS: Final = 65536  # a revolution of the motor

VALID: Final = 1 << 31  # this bit of a COB-ID is 0 when the PDO or EMCY exists
NO_RTR: Final = 1 << 30

SAVE: Final = int.from_bytes(b"save", "little")
LOAD: Final = int.from_bytes(b"load", "little")

MODES: Final = {1: "PP", 3: "PV", 4: "TQ", 6: "HM", 7: "IP", 8: "CSP", 9: "CSV", 10: "CST"}
HOMING_METHODS: Final = (-4, -3, -2, -1, *range(1, 15), *range(17, 31), 33, 34, 35, 37)

SYNC_TIMEOUT: Final = (0x2010, 1)


def _var(index: int, name: str, kind: DataType, access: str, default: int | bytes | OfNode = 0,
         pdo: str = "", low: int | None = None, high: int | None = None) -> Object:  # fmt: skip
    code = Kind.DOMAIN if kind is DOMAIN else Kind.VAR
    return Object(index, name, code, {0: Variable(name, kind, access, default, low, high, pdo)})


def _listed(index: int, name: str, kind: Kind, entries: Iterable[Variable]) -> Object:
    numbered = dict(enumerate(entries, 1))
    count = Variable("Highest sub-index supported", U8, "const", max(numbered))
    return Object(index, name, kind, {0: count, **numbered})


def _record(index: int, name: str, *entries: Variable) -> Object:
    return _listed(index, name, Kind.RECORD, entries)


def _array(index: int, name: str, *entries: Variable) -> Object:
    return _listed(index, name, Kind.ARRAY, entries)


def _counted(entry: Object, access: str, default: int, high: int) -> Object:
    """Give the number of entries of an object other rights than to be read."""
    count = replace(entry.entries[0], access=access, default=default, high=high)
    return replace(entry, entries={**entry.entries, 0: count})


def communication(axes: int, vendor: int, product: int, revision: int, serial: int,
                  name: bytes, hardware: bytes, software: bytes,
                  pdos: int = PDOS) -> Iterator[Object]:  # fmt: skip
    """Yield the objects 1000 to 1FFF, and those of the vendor at 2000."""
    yield _var(0x1000, "Device type", U32, "const", 0x0002_0192 if axes == 1 else 0xFFFF_0192)
    yield _var(0x1001, "Error register", U8, "ro", pdo="t")
    yield _var(0x1002, "Manufacturer status register", U32, "ro", pdo="t")
    errors = (Variable(f"Standard error field {n}", U32) for n in range(1, ERRORS_KEPT + 1))
    yield _counted(_array(0x1003, "Pre-defined error field", *errors), "rw", 0, ERRORS_KEPT)
    yield _var(0x1005, "COB-ID SYNC message", U32, "rw", 0x80)
    yield _var(0x1006, "Communication cycle period", U32, "rw")
    yield _var(0x1007, "Synchronous window length", U32, "rw")
    yield _var(0x1008, "Manufacturer device name", STRING, "const", name)
    yield _var(0x1009, "Manufacturer hardware version", STRING, "const", hardware)
    yield _var(0x100A, "Manufacturer software version", STRING, "const", software)
    yield _array(0x1010, "Store parameters", Variable("Save all parameters", U32, "rw", 1))
    yield _array(0x1011, "Restore default parameters",
                 Variable("Restore all default parameters", U32, "rw", 1))  # fmt: skip
    yield _var(0x1014, "COB-ID EMCY", U32, "rw", OfNode(0x80))
    yield _var(0x1015, "Inhibit time EMCY", U16, "rw")
    yield _array(0x1016, "Consumer heartbeat time",
                 *(Variable(f"Consumer heartbeat time {n}", U32, "rw") for n in range(1, 5)))  # fmt: skip
    yield _var(0x1017, "Producer heartbeat time", U16, "rw")
    yield _record(0x1018, "Identity object", Variable("Vendor-ID", U32, "const", vendor),
                  Variable("Product code", U32, "const", product),
                  Variable("Revision number", U32, "const", revision),
                  Variable("Serial number", U32, "const", serial))  # fmt: skip
    yield _var(0x1019, "Synchronous counter overflow value", U8, "rw", high=240)
    yield _var(0x1021, "Store EDS", DOMAIN, "ro")
    yield _var(0x1022, "Store format", U8, "const")
    yield _array(0x1029, "Error behaviour", Variable("Communication error", U8, "rw", high=2))
    yield _record(0x1200, "SDO server parameter",
                  Variable("COB-ID client to server (rx)", U32, "ro", OfNode(0x600)),
                  Variable("COB-ID server to client (tx)", U32, "ro", OfNode(0x580)))  # fmt: skip
    for number in range(pdos):
        yield from pdo_parameters(0x1400, "R", number)
    for number in range(pdos):
        yield from pdo_parameters(0x1800, "T", number)
    yield _var(0x2000, "Scratch memory", DOMAIN, "rw")
    yield _record(0x2010, "Supervision", Variable("SYNC timeout [ms]", U16, "rw", 500))


_DEFAULT_MAPS: Final[dict[str, tuple[tuple[int, ...], ...]]] = {
    "R": ((0x6040_0010,), (0x6040_0010, 0x6060_0008), (0x6040_0010, 0x607A_0020),
          (0x6040_0010, 0x60FF_0020)),
    "T": ((0x6041_0010,), (0x6041_0010, 0x6061_0008), (0x6041_0010, 0x6064_0020),
          (0x6041_0010, 0x606C_0020)),
}  # fmt: skip


def pdo_parameters(base: int, direction: str, number: int) -> Iterator[Object]:
    """Yield parameter and mapping of a PDO; 1 exists after a reset, the others have to be enabled.

    Those beyond the predefined connection set have no COB-ID until they are given one.
    """
    flags = (0 if direction == "R" else NO_RTR) | (VALID if number else 0)
    cob_id: int | OfNode = flags
    if number < PDOS:
        cob_id = OfNode(flags + (0x200 if direction == "R" else 0x180) + 0x100 * number)
    title = f"{direction}PDO"
    entries = {
        0: Variable("Highest sub-index supported", U8, "const", 5 if direction == "R" else 6),
        1: Variable("COB-ID used by PDO", U32, "rw", cob_id),
        2: Variable("Transmission type", U8, "rw", 255),
        3: Variable("Inhibit time", U16, "rw"),
        5: Variable("Event timer", U16, "rw"),
    }
    if direction == "T":
        entries[6] = Variable("SYNC start value", U8, "rw", high=240)
    yield Object(base + number, f"{title} communication parameter {number + 1}",
                 Kind.RECORD, entries)  # fmt: skip
    mapped = _DEFAULT_MAPS[direction][number] if number < PDOS else ()
    mapping = _record(base + 0x200 + number, f"{title} mapping parameter {number + 1}",
                      *(Variable(f"Application object {n}", U32, "rw", value) for n, value in
                        enumerate((*mapped, *[0] * (MAPPED - len(mapped))), 1)))  # fmt: skip
    yield _counted(mapping, "rw", len(mapped), 0xFF)


def axis(number: int, modes: Iterable[int] = MODES) -> Iterator[Object]:
    """Yield the CiA 402 objects of axis `number` (0, 1, ...), which has these modes of operation."""
    base = AXIS_STRIDE * number
    for entry in _axis(sum(1 << mode - 1 for mode in modes)):
        yield replace(entry, index=entry.index + base)


def _axis(supported_modes: int) -> Iterator[Object]:
    yield _var(0x6007, "Abort connection option code", I16, "rw", 0, low=0, high=3)
    yield _var(0x603F, "Error code", U16, "ro", pdo="t")
    yield _var(0x6040, "Controlword", U16, "rw", pdo="rt")
    yield _var(0x6041, "Statusword", U16, "ro", pdo="t")
    yield _var(0x605A, "Quick stop option code", I16, "rw", 2, low=0, high=8)
    yield _var(0x605B, "Shutdown option code", I16, "rw", 0, low=0, high=1)
    yield _var(0x605C, "Disable operation option code", I16, "rw", 1, low=0, high=1)
    yield _var(0x605D, "Halt option code", I16, "rw", 1, low=1, high=4)
    yield _var(0x605E, "Fault reaction option code", I16, "rw", 2, low=0, high=4)
    yield _var(0x6060, "Modes of operation", I8, "rw", pdo="rt")
    yield _var(0x6061, "Modes of operation display", I8, "ro", pdo="t")
    yield _var(0x6062, "Position demand value", I32, "ro", pdo="t")
    yield _var(0x6063, "Position actual internal value", I32, "ro", pdo="t")
    yield _var(0x6064, "Position actual value", I32, "ro", pdo="t")
    yield _var(0x6065, "Following error window", U32, "rw", COUNTS, "rt")
    yield _var(0x6066, "Following error time out", U16, "rw", 10, "rt")
    yield _var(0x6067, "Position window", U32, "rw", 100, "rt")
    yield _var(0x6068, "Position window time", U16, "rw", 5, "rt")
    yield _var(0x6069, "Velocity sensor actual value", I32, "ro", pdo="t")
    yield _var(0x606B, "Velocity demand value", I32, "ro", pdo="t")
    yield _var(0x606C, "Velocity actual value", I32, "ro", pdo="t")
    yield _var(0x606D, "Velocity window", U16, "rw", 3000, "rt")
    yield _var(0x606E, "Velocity window time", U16, "rw", 5, "rt")
    yield _var(0x606F, "Velocity threshold", U16, "rw", 1000, "rt")
    yield _var(0x6070, "Velocity threshold time", U16, "rw", 5, "rt")
    yield _var(0x6071, "Target torque", I16, "rw", pdo="rt")
    yield _var(0x6072, "Max torque", U16, "rw", 3000, "rt")
    yield _var(0x6073, "Max current", U16, "rw", 3000, "rt")
    yield _var(0x6074, "Torque demand", I16, "ro", pdo="t")
    yield _var(0x6075, "Motor rated current", U32, "rw", 2000, low=1)
    yield _var(0x6076, "Motor rated torque", U32, "rw", 1000, low=1)
    yield _var(0x6077, "Torque actual value", I16, "ro", pdo="t")
    yield _var(0x6078, "Current actual value", I16, "ro", pdo="t")
    yield _var(0x6079, "DC link circuit voltage", U32, "ro", pdo="t")
    yield _var(0x607A, "Target position", I32, "rw", pdo="rt")
    yield _var(0x607C, "Home offset", I32, "rw", pdo="rt")
    yield _array(0x607D, "Software position limit",
                 Variable("Min position limit", I32, "rw", I32.limits[0], pdo="rt"),
                 Variable("Max position limit", I32, "rw", I32.limits[1], pdo="rt"))  # fmt: skip
    yield _var(0x607E, "Polarity", U8, "rw", pdo="rt")
    yield _var(0x607F, "Max profile velocity", U32, "rw", 50 * COUNTS, "rt")
    yield _var(0x6080, "Max motor speed", U32, "rw", 3000, "rt")
    yield _var(0x6081, "Profile velocity", U32, "rw", 10 * COUNTS, "rt")
    yield _var(0x6082, "End velocity", U32, "rw", pdo="rt", high=0)
    yield _var(0x6083, "Profile acceleration", U32, "rw", 100 * COUNTS, "rt", low=1)
    yield _var(0x6084, "Profile deceleration", U32, "rw", 100 * COUNTS, "rt", low=1)
    yield _var(0x6085, "Quick stop deceleration", U32, "rw", 400 * COUNTS, "rt", low=1)
    yield _var(0x6086, "Motion profile type", I16, "rw", 0, "rt", low=0, high=0)
    yield _var(0x6087, "Torque slope", U32, "rw", 10_000, "rt", low=1)
    yield _ratio(0x608F, "Position encoder resolution", "Encoder increments", COUNTS,
                 "Motor revolutions", 1)  # fmt: skip
    yield _ratio(0x6091, "Gear ratio", "Motor revolutions", 1, "Shaft revolutions", 1)
    yield _ratio(0x6092, "Feed constant", "Feed", COUNTS, "Shaft revolutions", 1)
    yield _ratio(0x6096, "Velocity factor", "Numerator", 1, "Divisor", 1)
    yield _var(0x6098, "Homing method", I8, "rw", 35, "rt")
    yield _array(0x6099, "Homing speeds",
                 Variable("Speed during search for switch", U32, "rw", 5 * COUNTS, 1, pdo="rt"),
                 Variable("Speed during search for zero", U32, "rw", COUNTS // 2, 1, pdo="rt"))  # fmt: skip
    yield _var(0x609A, "Homing acceleration", U32, "rw", 100 * COUNTS, "rt", low=1)
    yield _var(0x60A8, "SI unit position", U32, "const", 0x00B5_0000)
    yield _var(0x60A9, "SI unit velocity", U32, "const", 0x00B5_0300)
    yield _var(0x60AA, "SI unit acceleration", U32, "const", 0x00B5_5700)
    yield _var(0x60B0, "Position offset", I32, "rw", pdo="rt")
    yield _var(0x60B1, "Velocity offset", I32, "rw", pdo="rt")
    yield _var(0x60B2, "Torque offset", I16, "rw", pdo="rt")
    yield _var(0x60C0, "Interpolation sub mode select", I16, "rw", 0, "rt", low=0, high=0)
    yield _array(0x60C1, "Interpolation data record",
                 Variable("Interpolation set-point", I32, "rw", pdo="rt"))  # fmt: skip
    yield _record(0x60C2, "Interpolation time period",
                  Variable("Interpolation time period value", U8, "rw", 4, 1),
                  Variable("Interpolation time index", I8, "rw", -3, -6, 0))  # fmt: skip
    yield _var(0x60C5, "Max acceleration", U32, "rw", 1000 * COUNTS, "rt", low=1)
    yield _var(0x60C6, "Max deceleration", U32, "rw", 1000 * COUNTS, "rt", low=1)
    yield _var(0x60E0, "Positive torque limit value", U16, "rw", 3000, "rt")
    yield _var(0x60E1, "Negative torque limit value", U16, "rw", 3000, "rt")
    methods = (Variable(f"Supported homing method {n}", I8, "const", method)
               for n, method in enumerate(HOMING_METHODS, 1))  # fmt: skip
    yield _array(0x60E3, "Supported homing methods", *methods)
    yield _var(0x60F2, "Positioning option code", U16, "rw", 0, "rt", high=2)
    yield _var(0x60F4, "Following error actual value", I32, "ro", pdo="t")
    yield _var(0x60F8, "Max slippage", I32, "rw", 20 * COUNTS, "rt", low=0)
    yield _var(0x60FA, "Control effort", I32, "ro", pdo="t")
    yield _var(0x60FC, "Position demand internal value", I32, "ro", pdo="t")
    yield _var(0x60FD, "Digital inputs", U32, "ro", pdo="t")
    yield _array(0x60FE, "Digital outputs",
                 Variable("Physical outputs", U32, "rw", pdo="rt"),
                 Variable("Bit mask", U32, "rw", pdo="rt"))  # fmt: skip
    yield _var(0x60FF, "Target velocity", I32, "rw", pdo="rt")
    yield _var(0x6402, "Motor type", U16, "const", 10)
    yield _var(0x6502, "Supported drive modes", U32, "const", supported_modes)
    yield _var(0x67FF, "Single device type", U32, "const", 0x0002_0192)


def _ratio(index: int, name: str, over: str, value: int, under: str, by: int) -> Object:
    return _array(index, name, Variable(over, U32, "rw", value, 1),
                  Variable(under, U32, "rw", by, 1))  # fmt: skip


TYPES: Final = {
    entry.index: variable.type
    for entry in axis(0)
    for variable in (entry.entries[max(entry.entries)],)
}
"""Type of each object of an axis; of an array or record that of its last entry."""
