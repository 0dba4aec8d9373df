"""What several servos of protocol 2.0 answer to one read: prepared once, taken apart in one go. No I/O.

`whole` is for the common case, in which everything arrived, undamaged and in order; what it does not take
is left to the parsers, which find what can be found.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple, Protocol

from crtk_driver_dynamixel.crc import crc16
from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.protocol2 import (
    ALERT,
    BROADCAST,
    SEQUENCE,
    TAIL,
    status_prefix,
    status_size,
)


class Whole(NamedTuple):
    """What all servos answered: their data, and their error bytes, of which only the alert can be set."""

    data: tuple[bytes, ...]
    alerts: tuple[int, ...]


class WholeReply(Protocol):
    """A reply of known size that brings the data of every servo."""

    size: int

    def whole(self, reply: bytes) -> Whole | None:
        """Return what `size` bytes say, None if they are not what was expected."""
        ...

    def fits(self, reply: bytes) -> bool:
        """Return whether the bytes that are there so far are as expected, as far as is seen quickly."""
        ...


def _plain(alerts: tuple[int, ...]) -> bool:
    """Return whether the error bytes hold no error numbers."""
    return not any(alerts) or not any(alert & ~ALERT for alert in alerts)


class PlainReplies:
    """The replies to a sync or bulk read: a status of each servo, one behind the other.

    Args:
        blocks: (id, length of data) in the order of the request.

    Attributes:
        ids: in this order.
        size: of all of them in bytes, without stuffing.
    """

    def __init__(self, blocks: Sequence[tuple[int, int]]) -> None:
        self.ids = tuple(id for id, _ in blocks)
        self._prefixes = tuple(status_prefix(id, length) for id, length in blocks)
        ends = list(accumulate(status_size(length) for _, length in blocks))
        self.size = ends[-1]
        self._starts = [0, *ends[:-1]]
        self._ends = ends
        self._checked = [slice(a, b - TAIL) for a, b in zip(self._starts, ends, strict=True)]
        layout = "".join(f"{len(self._prefixes[0])}sB{length}sH" for _, length in blocks)
        self._unpack = struct.Struct("<" + layout).unpack

    def whole(self, reply: bytes) -> Whole | None:
        """Return what `size` bytes say, None if they are not what was expected."""
        fields = self._unpack(reply)
        data, alerts = fields[2::4], fields[1::4]
        # Nothing is stuffed if the sequence occurs in the headers only.
        good = (
            fields[::4] == self._prefixes
            and _plain(alerts)
            and reply.count(SEQUENCE) == len(self._prefixes)
            and [crc16(reply[part]) for part in self._checked] == [*fields[3::4]]
        )
        return Whole(data, alerts) if good else None

    def fits(self, reply: bytes) -> bool:
        """Return whether the last of the replies that are complete is where it should be."""
        complete = bisect_right(self._ends, len(reply))
        index = max(complete - 1, 0)
        start = self._starts[index]
        prefix = self._prefixes[index]
        return prefix.startswith(reply[start : start + len(prefix)])


class FastReply:
    """The one reply to a fast sync or fast bulk read, which the servos write between them.

    It is ``header FE length 55``, then of each ``error id data CRC``, each CRC continuing the one before it.
    There is no stuffing. (E-manual, "Fast Sync Read".)

    Args:
        blocks: (id, length of data) in the order of the request.

    Attributes:
        ids: in this order.
        size: in bytes.
        data_size: of what would be the parameters of a status of this size.
        prefix: bytes with which it begins.
    """

    def __init__(self, blocks: Sequence[tuple[int, int]]) -> None:
        self._blocks = tuple(blocks)
        self.data_size = sum(length + 4 for _, length in blocks) - 3
        self.size = status_size(self.data_size)
        self.prefix = status_prefix(BROADCAST, self.data_size)
        self.ids = tuple(id for id, _ in blocks)
        layout = "".join(f"BB{length}sH" for _, length in blocks)
        self._unpack = struct.Struct(f"<{len(self.prefix)}s{layout}").unpack

    def whole(self, reply: bytes) -> Whole | None:
        """Return what `size` bytes say, None if they are not what was expected."""
        fields = self._unpack(reply)
        data, alerts = fields[3::4], fields[1::4]
        good = (
            fields[0] == self.prefix
            and fields[2::4] == self.ids
            and _plain(alerts)
            and crc16(reply[:-TAIL]) == fields[-1]
        )
        return Whole(data, alerts) if good else None

    def fits(self, reply: bytes) -> bool:
        """Return whether it begins as it should."""
        return self.prefix.startswith(reply[: len(self.prefix)])

    def blocks(self, reply: bytes) -> list[Status | None]:
        """Return the block of each servo as a status, None for those that are damaged or missing.

        A block whose CRC continues that of its predecessor correctly is good, whatever is damaged elsewhere.

        Args:
            reply: starting with `prefix`, but perhaps cut short or damaged.
        """
        found: list[Status | None] = []
        start = len(self.prefix)
        crc, since = 0, 0
        for id, length in self._blocks:
            end = start + 2 + length
            given = int.from_bytes(reply[end : end + TAIL], "little")
            if (
                len(reply) >= end + TAIL
                and reply[start + 1] == id
                and crc16(reply[since:end], crc) == given
            ):
                error = reply[start]
                found.append(Status(id, error & ~ALERT, error >= ALERT, reply[start + 2 : end]))
            else:
                found.append(None)
            crc, since, start = given, end, end + TAIL
        return found
