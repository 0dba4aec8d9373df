"""The wire of a CAN bus: one frame at a time, the lowest identifier of those waiting first.

Pure bookkeeping with times handed in; it waits for nothing. Every sender has a queue (first in,
first out, as the transmit queue of a network interface); the heads of the queues take part in the
arbitration when the bus becomes free. A frame is received by all others when its last bit is over.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Hashable, Mapping
from typing import Final, Generic, NamedTuple, TypeVar

from crtk_sim_backends.can import frames

STUFFING: Final[Mapping[str, Callable[[bytes], int]]] = {
    "exact": frames.exact_bits,
    "worst": frames.worst_bits,
    "none": frames.plain_bits,
}
"""How stuffed bits are counted, by name: frame to bits on the wire."""


Sender = TypeVar("Sender", bound=Hashable)


class Transfer(NamedTuple, Generic[Sender]):
    """One frame on the wire."""

    end: float  # s
    sender: Sender
    raw: bytes
    bits: int


class Load:
    """Share of the last second in which the bus was busy, kept in tenths of a second."""

    _SLOTS: Final = 10

    def __init__(self) -> None:
        self._busy = [0.0] * self._SLOTS  # s
        self._newest = 0

    def add(self, end: float, seconds: float) -> None:
        """Count a frame that ended at `end` (s) and took `seconds`."""
        self._advance(end)
        self._busy[self._newest % self._SLOTS] += seconds

    def last_second(self, now: float) -> float:
        """Busy share of the last whole second, 0.0 to 1.0."""
        self._advance(now)
        return min(1.0, sum(self._busy))

    def _advance(self, now: float) -> None:
        slot = int(now * self._SLOTS)
        for passed in range(max(self._newest + 1, slot - self._SLOTS + 1), slot + 1):
            self._busy[passed % self._SLOTS] = 0.0
        self._newest = max(self._newest, slot)


class Medium(Generic[Sender]):
    """The wire at a bit rate.

    Args:
        bitrate: bit/s, above zero.
        stuffing: one of `STUFFING`.
    """

    def __init__(self, bitrate: int, stuffing: str = "exact") -> None:
        self.bitrate = bitrate
        self.load = Load()
        self.bits = 0  # sent so far
        self._count_bits = STUFFING[stuffing]
        self._queues: dict[Sender, deque[tuple[float, bytes]]] = {}
        self._heads: list[tuple[int, int, Sender]] = []  # a heap: priority, sequence, sender
        self._sequence = 0
        self._sending: Transfer[Sender] | None = None
        self._free_at = 0.0

    def put(self, sender: Sender, raw: bytes, now: float) -> None:
        """Queue a frame of `sender`."""
        queue = self._queues.get(sender)
        if queue is None:
            queue = self._queues[sender] = deque()
        queue.append((now, raw))
        if len(queue) == 1:
            self._contend(sender, raw)

    def waiting(self, sender: Sender) -> int:
        """How many frames of `sender` have not begun to be sent."""
        return len(self._queues.get(sender, ()))

    def forget(self, sender: Sender) -> int:
        """Drop the frames of `sender` that have not begun to be sent, and return how many."""
        dropped = len(self._queues.pop(sender, ()))
        if dropped:
            self._heads = [head for head in self._heads if head[2] is not sender]
            heapq.heapify(self._heads)
        return dropped

    @property
    def next_at(self) -> float | None:
        """When `due` has something to do (s), or None while nothing is to be sent."""
        if self._sending is not None:
            return self._sending.end
        return self._free_at if self._heads else None

    def due(self, now: float) -> list[Transfer[Sender]]:
        """Frames whose last bit is over, in order; lets the next ones begin."""
        done = []
        if self._sending is None and self._free_at <= now:
            self._begin()
        while self._sending is not None and self._sending.end <= now:
            done.append(self._sending)
            self._begin()
        return done

    def _contend(self, sender: Sender, raw: bytes) -> None:
        self._sequence += 1
        can_id = int.from_bytes(raw[:4], "little")
        heapq.heappush(self._heads, (frames.priority(can_id), self._sequence, sender))

    def _begin(self) -> None:
        """Let the winner of the arbitration begin, as soon as it and the bus were ready."""
        self._sending = None
        if not self._heads:
            return
        _, _, sender = heapq.heappop(self._heads)
        queue = self._queues[sender]
        arrived, raw = queue.popleft()
        if queue:
            self._contend(sender, queue[0][1])
        else:
            del self._queues[sender]
        bits = self._count_bits(raw)
        seconds = bits / self.bitrate
        self._free_at = max(self._free_at, arrived) + seconds
        self._sending = Transfer(self._free_at, sender, raw, bits)
        self.bits += bits
        self.load.add(self._free_at, seconds)
