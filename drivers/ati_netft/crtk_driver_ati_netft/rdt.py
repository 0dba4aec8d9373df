"""RDT, the protocol of the stream: requests to the sensor and its records. Bytes in, values out, no I/O.

Requests are 8 bytes, records 36 bytes, everything big-endian. A datagram
holds one record or, in buffered mode, several. (ATI 9620-05-NET FT and 9610-05-Ethernet Axia, chapters on
the UDP interface.)
"""

from __future__ import annotations

import struct
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

PORT: Final = 49152
HEADER: Final = 0x1234
MOST_RECORDS: Final = 40
"""Records that a sensor puts into one datagram at most."""

RECORD: Final = np.dtype(
    [
        ("rdt_sequence", ">u4"),
        ("ft_sequence", ">u4"),
        ("status", ">u4"),
        ("counts", ">i4", (6,)),
    ]
)
"""One record. Forces are counts 0 to 2, torques 3 to 5."""

RECORD_SIZE: Final = RECORD.itemsize

Records = NDArray[np.void]
"""Of dtype `RECORD`."""

_REQUEST = struct.Struct(">HHI")


def encode_request(command: int, count: int = 0) -> bytes:
    """Return a request.

    Args:
        command: see `crtk_driver_ati_netft.profiles`.
        count: of records to send, 0 for no end; some commands take a value here.

    Raises:
        ValueError: a number that does not fit.
    """
    try:
        return _REQUEST.pack(HEADER, command, count)
    except struct.error as error:
        raise ValueError(f"not a request: command {command}, count {count}") from error


def native(records: Records) -> NDArray[np.int32]:
    """Return all numbers of records as this machine has them: (n, 9), in the order of `RECORD`."""
    return records.view(">i4").reshape(-1, 9).astype(np.int32)


class Decoded(NamedTuple):
    """The records of several datagrams, in the order of arrival.

    `source` is the index of the datagram of each record, None where each datagram holds one.
    """

    records: Records
    source: NDArray[np.intp] | None
    malformed: int


def decode_batch(slots: NDArray[np.uint8], lengths: NDArray[Any]) -> Decoded:
    """Return the records of many datagrams at once.

    Args:
        slots: (n, size), one datagram a row.
        lengths: (n,) bytes of each; one that is longer than its row is malformed.
    """
    size = int(lengths[0]) if lengths.size else RECORD_SIZE
    if size and size <= slots.shape[1] and not size % RECORD_SIZE and (lengths == size).all():
        records = slots[:, :size].copy().view(RECORD)
        if size == RECORD_SIZE:
            return Decoded(records[:, 0], None, 0)
        each = size // RECORD_SIZE
        return Decoded(records.reshape(-1), np.repeat(np.arange(len(lengths)), each), 0)
    good = np.flatnonzero(
        (lengths > 0) & (lengths % RECORD_SIZE == 0) & (lengths <= slots.shape[1])
    )
    data = b"".join([slots[i, : lengths[i]].tobytes() for i in good.tolist()])
    source = np.repeat(good, lengths[good] // RECORD_SIZE)
    return Decoded(np.frombuffer(data, RECORD), source, int(lengths.size - good.size))
