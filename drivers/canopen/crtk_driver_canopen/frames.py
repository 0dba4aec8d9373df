"""Classic CAN frames, and their bytes on a socket of the kernel: `struct can_frame` of linux/can.h."""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from crtk_drivers.errors import ProtocolError

EXTENDED: Final = 0x8000_0000
"""Flag in an identifier: it has 29 bits (CAN_EFF_FLAG)."""

REMOTE: Final = 0x4000_0000
"""Flag in an identifier: the frame asks for data (CAN_RTR_FLAG)."""

ERROR: Final = 0x2000_0000
"""Flag in an identifier: the controller tells of errors (CAN_ERR_FLAG; linux/can/error.h)."""

STANDARD: Final = 0x7FF
"""Highest identifier of 11 bits; what is above, flags included, is no data frame of CANopen."""

_LAYOUT: Final = struct.Struct("=IB3x8s")


class Frame(NamedTuple):
    """One frame.

    Attributes:
        can_id: identifier, with the flags above.
        data: 0 to 8 bytes; those of a remote frame have no meaning.
        own: whether it was sent by this computer and came back.
        time: seconds of the day at which it was received; 0: not told.
    """

    can_id: int
    data: bytes
    own: bool = False
    time: float = 0.0


def pack(frame: Frame) -> bytes:
    """Return the bytes of a frame.

    Raises:
        struct.error: the identifier has more than 32 bits.
    """
    return _LAYOUT.pack(frame.can_id, len(frame.data), frame.data)


def unpack(raw: bytes, own: bool = False, time: float = 0.0) -> Frame:
    """Return the frame of some bytes; data beyond the eighth (CAN FD) are left out.

    Raises:
        ProtocolError: too few bytes.
    """
    try:
        can_id, length, data = _LAYOUT.unpack_from(raw)
    except struct.error:
        raise ProtocolError(
            f"{len(raw)} bytes are no CAN frame, which has {_LAYOUT.size}"
        ) from None
    return Frame(can_id, data[:length], own, time)
