"""What a box is told over TCP, what it answers, and its datagrams: values in, bytes out, and back. No I/O.

Sources: interface control document of the FTS Ethernet box as SCHUNK's driver library has it
(schunk_force_torque_sensor, utility.py and driver.py). All numbers are little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.kit import BadData
from crtk_drivers.kit.sensing.status_words import Bit, Meaning, StatusTable

__all__ = [
    "ERRORS",
    "NO_SUCH",
    "READY",
    "RECORD",
    "STATUS",
    "Op",
    "Parameter",
    "Reply",
    "decode",
    "parse_reply",
    "reply_size",
    "request",
]

_HEAD: Final = struct.Struct("<2sHH")
_SYNC: Final = b"\xff\xff"
LONGEST: Final = 512
"""Bytes of a payload."""


class Op(IntEnum):
    """Commands."""

    TARE = 0x12
    RESET_TARE = 0x13
    START = 0x40
    STOP = 0x41
    GET = 0xF0
    SET = 0xF1


class Parameter(NamedTuple):
    """Index and subindex."""

    main: int
    sub: int


NAME: Final = Parameter(0x0001, 0)
OUTPUT_RATE: Final = Parameter(0x1020, 0)
UDP_PORT: Final = Parameter(0x1033, 0)

NO_SUCH: Final = frozenset({0x13, 0x14})
ERRORS: Mapping[int, str] = MappingProxyType(
    {
        0x01: "unknown command",
        0x02: "invalid command length",
        0x03: "invalid command value",
        0x04: "busy",
        0x05: "the stream is on",
        0x06: "storage error",
        0x07: "error of its internal bus",
        0x08: "time-out",
        0x10: "user level not sufficient",
        0x11: "read only",
        0x12: "write only",
        0x13: "there is no such index",
        0x14: "there is no such subindex",
        0x15: "invalid length of a value",
        0x16: "invalid value",
        0x17: "login failed",
        0x18: "login blocked",
        0x19: "its parameters are locked",
        0x30: "verification of an update failed",
        0x31: "error of an update",
    }
)
"""By the error byte of a reply."""


class Reply(NamedTuple):
    """What a box answers: command, error (0: none), and for GET and SET the parameter and its value."""

    op: int
    error: int
    parameter: Parameter | None = None
    value: bytes = b""


def request(op: Op, parameter: Parameter | None = None, value: bytes = b"") -> bytes:
    """Return a request; a parameter belongs to GET and SET."""
    payload = bytes((op,))
    if parameter is not None:
        payload += struct.pack("<HB", *parameter) + value
    return _HEAD.pack(_SYNC, 0, len(payload)) + payload


def reply_size(data: bytes) -> int:
    """Return how long the reply at the start of a buffer is, 0: not to be told yet.

    Raises:
        BadData: there is none.
    """
    if len(data) < _HEAD.size:
        if not _SYNC.startswith(data[:2]):
            raise BadData(f"{data[:20].hex(' ')}")
        return 0
    sync, _, size = _HEAD.unpack_from(data)
    if sync != _SYNC or not 2 <= size <= LONGEST:
        raise BadData(f"{data[:20].hex(' ')}")
    return int(_HEAD.size + size)


def parse_reply(frame: bytes) -> Reply:
    """Return what a whole reply says.

    Raises:
        ValueError: it is none.
    """
    op, error, *_ = payload = frame[_HEAD.size :]
    if op not in (Op.GET, Op.SET):
        return Reply(op, error)
    if len(payload) < 5:
        if error:
            return Reply(op, error)
        raise ValueError(f"{len(payload)} bytes as answer about a parameter")
    index, sub = struct.unpack_from("<HB", payload, 2)
    return Reply(op, error, Parameter(index, sub), payload[5:])


# ------------------------------------------------------------------------------------------ datagrams

RECORD: Final = np.dtype(
    [
        ("sync", "<u2"),
        ("counter", "<u2"),
        ("size", "<u2"),
        ("id", "u1"),
        ("status", "<u4"),
        ("load", "<f4", (6,)),
    ]
)
"""A datagram with one measurement: forces in N, then torques in N·m."""
_SIZE: Final = RECORD.itemsize - _HEAD.size

READY: Final = 1 << 0
"""Of a status word; it is the only bit that is good news, and turned round for `STATUS`."""
STATUS: Final = StatusTable(
    (
        Bit(1 << 5, Meaning.NOTICE, "beyond the range that the user has set"),
        Bit(1 << 4, Meaning.SATURATED, "beyond its mechanical range"),
        Bit(1 << 3, Meaning.ERROR, "hardware error"),
        Bit(1 << 2, Meaning.NOTICE, "temperature out of range"),
        Bit(1 << 1, Meaning.ERROR, "its data are invalid"),
        Bit(READY, Meaning.ERROR, "not ready for operation"),
    ),
    has_summary=False,
)


def decode(
    slots: NDArray[np.uint8], lengths: NDArray[np.uint32]
) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """Return the measurements in datagrams.

    Args:
        slots: (n, at least 35) bytes.
        lengths: of the datagrams (n,).

    Returns:
        records of `RECORD`, in memory of their own, status words with READY turned round; and which of the
        datagrams they are, None: all of them. A load that is no number makes no record.
    """
    records = slots[:, : RECORD.itemsize].copy().view(RECORD)[:, 0]
    good = (lengths == RECORD.itemsize) & (records["sync"] == 0xFFFF) & (records["size"] == _SIZE)
    good &= np.isfinite(records["load"]).all(axis=1)
    kept = None if good.all() else good
    records = records if kept is None else records[kept]
    records["status"] ^= READY
    return records, kept
