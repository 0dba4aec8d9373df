"""Why an SDO server refuses: the abort codes of CiA 301, table 22."""

from __future__ import annotations

from enum import IntEnum


class Abort(IntEnum):
    """Abort code of an SDO transfer."""

    TOGGLE = 0x0503_0000
    TIMEOUT = 0x0504_0000
    COMMAND = 0x0504_0001
    BLOCK_SIZE = 0x0504_0002
    SEQUENCE = 0x0504_0003
    CRC = 0x0504_0004
    MEMORY = 0x0504_0005
    UNSUPPORTED_ACCESS = 0x0601_0000
    WRITE_ONLY = 0x0601_0001
    READ_ONLY = 0x0601_0002
    NO_OBJECT = 0x0602_0000
    NOT_MAPPABLE = 0x0604_0041
    PDO_LENGTH = 0x0604_0042
    INCOMPATIBLE_PARAMETER = 0x0604_0043
    INCOMPATIBLE_INTERNAL = 0x0604_0047
    HARDWARE = 0x0606_0000
    LENGTH = 0x0607_0010
    TOO_LONG = 0x0607_0012
    TOO_SHORT = 0x0607_0013
    NO_SUBINDEX = 0x0609_0011
    VALUE = 0x0609_0030
    VALUE_HIGH = 0x0609_0031
    VALUE_LOW = 0x0609_0032
    MAX_BELOW_MIN = 0x0609_0036
    NO_RESOURCE = 0x060A_0023
    GENERAL = 0x0800_0000
    STORE = 0x0800_0020
    LOCAL_CONTROL = 0x0800_0021
    DEVICE_STATE = 0x0800_0022
    NO_DATA = 0x0800_0024


class SdoAbort(ValueError):
    """An access to the object dictionary is refused.

    Args:
        code: abort code, one of :class:`Abort` or any 32-bit number.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort 0x{code:08X}")
        self.code = code
