"""Classic CAN frames as bytes: `struct can_frame` of linux/can.h, little-endian, 16 bytes.

Source of the layout and the flags: linux/can.h and linux/can/error.h; of the bit counts:
ISO 11898-1 (frame formats, bit stuffing, CRC-15).
"""

from __future__ import annotations

import struct
from typing import Final

EXTENDED: Final = 0x80000000  # CAN_EFF_FLAG
REMOTE: Final = 0x40000000  # CAN_RTR_FLAG
ERROR: Final = 0x20000000  # CAN_ERR_FLAG
STANDARD_MASK: Final = 0x7FF
EXTENDED_MASK: Final = 0x1FFFFFFF

SIZE: Final = 16
MAX_DATA: Final = 8

LAYOUT: Final = struct.Struct("<IB3x8s")
"""can_id with flags, data length, padding, data."""

OWN_AT: Final = 5  # a byte of the padding, 1 in a frame that returns to its sender

# Classes of error frames, in the identifier (linux/can/error.h).
ERROR_CONTROLLER: Final = 0x004
ERROR_PROTOCOL: Final = 0x008
ERROR_NO_ACK: Final = 0x020
ERROR_BUS_OFF: Final = 0x040
ERROR_BUS: Final = 0x080
ERROR_RESTARTED: Final = 0x100

# Bits of data[1] of ERROR_CONTROLLER.
PASSIVE_RECEIVE: Final = 0x10
PASSIVE_TRANSMIT: Final = 0x20
ACTIVE_AGAIN: Final = 0x40

ERROR_FRAME_BITS: Final = 23  # error flag 6..12, delimiter 8, intermission 3

_PAD: Final = bytes(MAX_DATA)


def pack(can_id: int, data: bytes = b"", length: int | None = None) -> bytes:
    """Build the 16 bytes of a frame.

    Args:
        can_id: identifier with the flags EXTENDED and REMOTE.
        data: 0 to 8 bytes.
        length: data length code of a remote frame, which has no data.
    """
    return LAYOUT.pack(can_id, len(data) if length is None else length, data)


def unpack(raw: bytes) -> tuple[int, bytes]:
    """Return identifier with flags, and the data (zeros of the requested length: remote frame)."""
    can_id, length, data = LAYOUT.unpack(raw)
    return can_id, data[:length]


def error_frame(classes: int, data: bytes = _PAD) -> bytes:
    """Build an error frame of some classes (`ERROR_...`)."""
    return LAYOUT.pack(ERROR | classes, MAX_DATA, data)


def own(raw: bytes) -> bytes:
    """Mark a frame that returns to its sender."""
    return raw[:OWN_AT] + b"\x01" + raw[OWN_AT + 1 :]


def fault_of(raw: bytes) -> str | None:
    """Why a frame cannot be sent, or None: not 16 bytes, too long, identifier out of range."""
    if len(raw) != SIZE:
        return f"a frame has {SIZE} bytes, not {len(raw)}"
    can_id, length, _ = LAYOUT.unpack(raw)
    if can_id <= STANDARD_MASK and length <= MAX_DATA:
        return None
    if length > MAX_DATA:
        return f"a frame has at most {MAX_DATA} data bytes, not {length}"
    if can_id & ERROR:
        return "an error frame cannot be sent"
    if not can_id & EXTENDED and can_id & EXTENDED_MASK > STANDARD_MASK:
        return f"identifier {can_id & EXTENDED_MASK:#x} needs the extended format"
    return None


def priority(can_id: int) -> int:
    """Order of arbitration: of frames that start together the smallest number wins.

    The bits in the order in which they are sent: identifier (the eleven first bits), RTR or SRR,
    IDE, then for the extended format eighteen more and RTR; 0 is dominant. Error frames come first.
    """
    if can_id & ERROR:
        return -1
    remote = 1 if can_id & REMOTE else 0
    if not can_id & EXTENDED:
        return (can_id & STANDARD_MASK) << 21 | remote << 20
    number = can_id & EXTENDED_MASK
    return (number >> 18) << 21 | 0b11 << 19 | (number & 0x3FFFF) << 1 | remote


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = (crc << 1) ^ (0x4599 if crc & 0x4000 else 0)
        table.append(crc & 0x7FFF)
    return table


def _stuff_table() -> list[list[tuple[int, int]]]:
    """For each state and byte: the state after it, and how many bits are stuffed.

    A state is ``2 * (run - 1) + last bit``, `run` 1..4 the length of the run of equal bits that
    is on the wire so far; a run of five is followed at once by its stuffed bit, which is a run of
    one of the other value.
    """
    table = []
    for state in range(8):
        row = []
        for byte in range(256):
            run, last, stuffed = state // 2 + 1, state % 2, 0
            for shift in range(7, -1, -1):
                bit = byte >> shift & 1
                run, last = (run + 1, last) if bit == last else (1, bit)
                if run == 5:
                    run, last, stuffed = 1, 1 - last, stuffed + 1
            row.append((2 * (run - 1) + last, stuffed))
        table.append(row)
    return table


_CRC: Final = _crc_table()
_STUFF: Final = _stuff_table()
_BEFORE_START: Final = 1  # the bus idles recessive; the start of frame begins a new run
_TAIL_BITS: Final = 13  # CRC delimiter, ACK slot and delimiter, end of frame, intermission


def _stuffable(raw: bytes) -> tuple[int, int]:
    """Return the bits from start of frame to CRC as a number, and how many they are."""
    can_id, length, data = LAYOUT.unpack(raw)
    remote = 1 if can_id & REMOTE else 0
    if can_id & EXTENDED:
        number = can_id & EXTENDED_MASK
        header = ((number >> 18) << 2 | 0b11) << 18 | number & 0x3FFFF
        header, width = header << 7 | remote << 6 | length, 39
    else:
        header, width = (can_id & STANDARD_MASK) << 7 | remote << 6 | length, 19
    if length and not remote:
        header = header << 8 * length | int.from_bytes(data[:length], "big")
        width += 8 * length
    crc = 0
    for byte in header.to_bytes((width + 7) // 8, "big"):
        crc = (crc << 8 & 0x7FFF) ^ _CRC[crc >> 7 ^ byte]
    return header << 15 | crc, width + 15


def exact_bits(raw: bytes) -> int:
    """Bits that the frame takes on the wire, its own stuffed bits and the intermission included."""
    if raw[3] & 0x20:
        return ERROR_FRAME_BITS
    bits, width = _stuffable(raw)
    padding = -width % 8
    bits |= (0x55 & (1 << padding) - 1) << width  # alternating, recessive last: stuffs nothing
    state, stuffed = _BEFORE_START, 0
    for byte in bits.to_bytes((width + padding) // 8, "big"):
        state, more = _STUFF[state][byte]
        stuffed += more
    return width + stuffed + _TAIL_BITS


def plain_bits(raw: bytes) -> int:
    """Bits that the frame takes without any stuffed bit, the intermission included."""
    if raw[3] & 0x20:
        return ERROR_FRAME_BITS
    data = 0 if raw[3] & 0x40 else 8 * raw[4]
    return (67 if raw[3] & 0x80 else 47) + data


def worst_bits(raw: bytes) -> int:
    """Bits that a frame of this format and length takes with the most stuffed bits possible."""
    if raw[3] & 0x20:
        return ERROR_FRAME_BITS
    plain = plain_bits(raw)
    return plain + (plain - _TAIL_BITS - 1) // 4
