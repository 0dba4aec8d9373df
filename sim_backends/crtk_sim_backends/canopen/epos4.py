"""What a Maxon EPOS4 has otherwise than CiA 402 says, as data of the simulated one.

Objects and defaults are those that the vendor's EDS of the EPOS4 Module 24/1.5 (firmware 0150, hardware 6050)
lists. What no file tells (that 6502 lies, that method 0 is refused, error 8A88 with STO) was seen on real
drives.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from crtk_sim_backends.canopen.dictionary import DataType, Key, Kind, Object, OfNode, Variable

VENDOR: Final = 0x0000_00FB
PRODUCT: Final = 0x6050_0000
REVISION: Final = 0x0150_0000
DEVICE: Final = "EPOS4 Module 24/1.5"

TELLS_MODES: Final = 0x225  # pp, pv, hm, cst

PULSES: Final = (0x3010, 1)
HOME_POSITION: Final = (0x30B0, 0)
HOME_MOVE: Final = (0x30B1, 0)

CODES: Final = ((0x7121, 0xFF01), (0x7305, 0x7380), (0x8700, 0x6080), (0xFF01, 0x8A88))
LIMIT_CODES: Final = (0x8A80, 0x8A81)

_VALID: Final = 1 << 31
_NO_RTR: Final = 1 << 30
_PULSES: Final = 500
_RPM: Final = 0x00B4_4700
_RPM_PER_SECOND: Final = 0x00C0_0300

CONSTANT: Final = frozenset({0x1005, 0x1014})

LACKS: Final[frozenset[int | Key]] = frozenset(
    {
        *(
            0x1002,
            0x1006,
            0x1007,
            0x1009,
            0x100A,
            0x1015,
            0x1019,
            0x1021,
            0x1022,
            0x1029,
            0x2000,
            0x2010,
        ),
        *(
            0x605D,
            0x6063,
            0x6067,
            0x6068,
            0x6069,
            0x606D,
            0x606E,
            0x606F,
            0x6070,
            0x6072,
            0x6073,
            0x6074,
        ),
        *(
            0x6075,
            0x6078,
            0x6079,
            0x607C,
            0x607E,
            0x6082,
            0x6087,
            0x608F,
            0x6091,
            0x6092,
            0x6096,
            0x60C0,
        ),
        *(0x60C1, 0x60C6, 0x60E0, 0x60E1, 0x60E3, 0x60F2, 0x60F8, 0x60FA, 0x60FC, 0x67FF),
        *((index, sub) for index in range(0x1400, 0x1404) for sub in (3, 5)),
        *((index, 6) for index in range(0x1800, 0x1804)),
    }
)
"""By index, or index and sub-index. 1400 to 1403 have COB-ID and type alone: no deadline."""


def _cob_ids() -> Iterator[tuple[int, int, OfNode]]:
    """Yield the COB-IDs: all RPDOs are valid, and of the TPDOs the first."""
    for number in range(4):
        yield 0x1400 + number, 1, OfNode(0x200 + 0x100 * number)
        off = _VALID if number else 0
        yield 0x1800 + number, 1, OfNode(off + _NO_RTR + 0x180 + 0x100 * number)


DEFAULTS: Final[tuple[tuple[int, int, int | OfNode], ...]] = (
    *_cob_ids(),
    *((0x1800 + number, 3, 10) for number in range(4)),
    (0x6007, 0, 3), (0x605A, 0, 6), (0x605B, 0, 0), (0x605C, 0, 1), (0x605E, 0, 2),
    (0x6060, 0, 1), (0x6065, 0, 2000), (0x6067, 0, 3), (0x606D, 0, 3), (0x606F, 0, 1),
    (0x6076, 0, 1_000_000), (0x607D, 1, 0), (0x607D, 2, 0), (0x607F, 0, 50_000), (0x6080, 0, 50_000),
    (0x6081, 0, 1000), (0x6083, 0, 10_000), (0x6084, 0, 10_000), (0x6085, 0, 10_000),
    (0x608F, 1, 4 * _PULSES), (0x6098, 0, 7), (0x6099, 1, 100), (0x6099, 2, 10), (0x609A, 0, 1000),
    (0x60A8, 0, 0x00B5_0000), (0x60A9, 0, _RPM), (0x60AA, 0, _RPM_PER_SECOND),
    (0x60C2, 1, 1), (0x60C2, 2, -3), (0x60C5, 0, 0xFFFF_FFFF), (0x60C6, 0, 0xFFFF_FFFF),
    (0x60F8, 0, 2000),
)  # fmt: skip


def _variable(index: int, name: str, kind: DataType, value: int, access: str = "rw") -> Object:
    return Object(index, name, Kind.VAR, {0: Variable(name, kind, access, value)})


ADDS: Final = (
    _variable(0x2000, "Node-ID", DataType.U8, 1, "ro"),
    _variable(0x2001, "CAN bit rate", DataType.U8, 0),
    Object(
        0x3001,
        "Motor data",
        Kind.RECORD,
        {
            0: Variable("Highest sub-index supported", DataType.U8, "ro", 5),
            1: Variable("Nominal current", DataType.U32, "rw", 2000),
            2: Variable("Output current limit", DataType.U32, "rw", 4000),
            3: Variable("Number of pole pairs", DataType.U8, "rw", 1),
            4: Variable("Thermal time constant winding", DataType.U16, "rw", 40),
            5: Variable("Motor torque constant", DataType.U32, "rw", 500_000),
        },
    ),
    Object(
        0x3010,
        "Digital incremental encoder 1",
        Kind.RECORD,
        {
            0: Variable("Highest sub-index supported", DataType.U8, "ro", 1),
            1: Variable("Number of pulses", DataType.U32, "rw", _PULSES, 16),
        },
    ),
    _variable(0x30B0, "Home position", DataType.I32, 0),
    _variable(0x30B1, "Home offset move distance", DataType.I32, 0),
    _variable(0x30B2, "Current threshold for homing mode", DataType.U16, 500),
)
"""Objects of the vendor's that matter to a master."""
