"""RDT, the protocol of the stream: requests to the sensor and its records. Bytes in, values out, no I/O.

Requests are 8 bytes (14 with an address of the stream), records 36 bytes, everything big-endian. A datagram
holds one record or, in buffered mode, several. (ATI 9620-05-NET FT and 9610-05-Ethernet Axia, chapters on
the UDP interface.)
"""

from __future__ import annotations

import socket
import struct
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

PORT: Final = 49152
HEADER: Final = 0x1234
MOST_RECORDS: Final = 40
"""Records that a sensor puts into one datagram at most."""
EXTENDED: Final = 0x8000
"""Added to a command that is followed by the address for the records."""

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


def encode_request(command: int, count: int = 0, redirect: tuple[str, int] | None = None) -> bytes:
    """Return a request.

    Args:
        command: see `crtk_driver_ati_netft.profiles`.
        count: of records to send, 0 for no end; some commands take a value here.
        redirect: IPv4 address (a multicast group as well) and port that the records are sent to, instead
            of those that the request came from. Net Box only.

    Raises:
        ValueError: a number that does not fit, or no IPv4 address.
    """
    try:
        if redirect is None:
            return _REQUEST.pack(HEADER, command, count)
        host, port = redirect
        request = _REQUEST.pack(HEADER, command | EXTENDED, count)
        return request + socket.inet_aton(host) + struct.pack(">H", port)
    except (struct.error, OSError) as error:
        raise ValueError(
            f"not a request: command {command}, count {count}, to {redirect}"
        ) from error


def decode(datagram: bytes | bytearray | memoryview) -> Records | None:
    """Return the records of one datagram, without a copy; None if it holds no whole number of them."""
    if not datagram or len(datagram) % RECORD_SIZE:
        return None
    return np.frombuffer(datagram, RECORD)


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
