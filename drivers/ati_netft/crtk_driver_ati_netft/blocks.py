"""The measurements at the sensor's full rate, for programs in the same process.

A block is an array of `MEASUREMENT`, oldest first. `BlockRing` keeps the last seconds of them: one thread
adds, any number of readers follow, each at its own pace, and are told what they missed.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

MEASUREMENT: Final = np.dtype(
    [
        ("stamp", np.int64),
        ("ticks", np.int64),
        ("sequence", np.uint32),
        ("status", np.uint32),
        ("raw", np.float64, (6,)),
        ("wrench", np.float64, (6,)),
    ]
)
"""One measurement.

``stamp`` of the measurement in ns since the epoch; ``ticks`` its number on the sensor's clock; ``sequence``
and ``status`` of its record; ``raw`` force in N and torque in N·m as the sensor gives them, in its frame;
``wrench`` the same without bias and weight of the tool, about the point and in the axes that are configured;
not a number while the weight is not known, for want of the orientation.
"""

Block = NDArray[np.void]
"""(n,), of dtype `MEASUREMENT`."""


class BlockRing:
    """The newest measurements.

    Args:
        size: how many it holds.
    """

    def __init__(self, size: int) -> None:
        self._ring = np.zeros(size, MEASUREMENT)
        self._added = 0
        self._closed = True
        self._changed = threading.Condition()

    def open(self) -> None:
        """Let readers wait for more."""
        with self._changed:
            self._closed = False

    def close(self) -> None:
        """Let readers come to an end."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def is_open(self) -> bool:
        """Whether more is to be waited for."""
        return not self._closed

    def add(self, block: Block) -> None:
        """Add measurements; wakes the readers."""
        size = len(self._ring)
        kept = block[-size:]
        with self._changed:
            begin = (self._added + len(block) - len(kept)) % size
            first = min(len(kept), size - begin)
            self._ring[begin : begin + first] = kept[:first]
            if first < len(kept):
                self._ring[: len(kept) - first] = kept[first:]
            self._added += len(block)
            self._changed.notify_all()

    def reader(self) -> BlockReader:
        """Return a reader that begins with the next measurement."""
        return BlockReader(self, self._added)

    def newest(self, count: int) -> Block:
        """Return the newest measurements, at most `count` of them."""
        with self._changed:
            return self._copy(max(0, self._added - count))

    def after(self, position: int, timeout: float | None) -> tuple[Block, int, bool]:
        """Return what came after a position, the new position, and whether the ring is closed.

        Waits for at most `timeout` s (None: without end) until there is something.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._added > position or self._closed, timeout)
            return self._copy(position), self._added, self._closed

    def _copy(self, position: int) -> Block:
        size = len(self._ring)
        begin = max(position, self._added - size)
        count = self._added - begin
        first = min(count, size - begin % size)
        block = np.empty(count, MEASUREMENT)
        block[:first] = self._ring[begin % size :][:first]
        block[first:] = self._ring[: count - first]
        return block


class BlockReader:
    """Follows a `BlockRing`. Iterate over it for blocks until the device is closed, or `read`.

    Attributes:
        missed: measurements that were gone before they were read.
    """

    def __init__(self, ring: BlockRing, position: int) -> None:
        self.missed = 0
        self._ring = ring
        self._position = position

    def read(self, timeout: float | None = 1.0) -> Block:
        """Return what came since the last call, waiting for at most `timeout` s; may be empty."""
        return self._next(timeout)[0]

    def __iter__(self) -> Iterator[Block]:
        while True:
            block, closed = self._next(None)
            if len(block):
                yield block
            elif closed:
                return

    def _next(self, timeout: float | None) -> tuple[Block, bool]:
        block, position, closed = self._ring.after(self._position, timeout)
        self.missed += position - self._position - len(block)
        self._position = position
        return block, closed
