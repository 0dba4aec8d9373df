"""Reads and writes of several servos at once, prepared once and run in every cycle.

A servo that is silent costs the time of its own slot: those behind it are asked anew without it, as some
stay silent when the one before them does. After several times in a row it is left out, and tried again
every now and then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from crtk_driver_dynamixel import protocol2
from crtk_driver_dynamixel.matching import Slot
from crtk_driver_dynamixel.protocol2 import FastReplyParser
from crtk_driver_dynamixel.protocols import PROTOCOLS
from crtk_driver_dynamixel.replies import Failure, Reply

if TYPE_CHECKING:
    from crtk_driver_dynamixel.bus import Bus

__all__ = ["GroupRead", "GroupResult", "GroupWrite", "Item"]

LEAVE_OUT_AFTER: Final = 3
"""Times in a row that a servo is silent before it is left out."""
TRY_EVERY: Final = 10
"""Cycles between two tries of a servo that is left out."""
MOST_GAPS: Final = 3
"""Servos in a row whose silence is waited for in one cycle."""
FAST_FAILURES: Final = 3
"""Times in a row that a fast read may fail before a plain one takes its place."""
FAST_AGAIN: Final = 200
"""Cycles after which a fast read is tried again."""


class Item(NamedTuple):
    """What to read of one servo."""

    id: int
    address: int
    length: int


@dataclass(frozen=True)
class GroupResult:
    """The replies of a group, in its order.

    Attributes:
        replies: one for each servo, with its data or the reason why there are none.
        lengths: bytes that each should bring.
    """

    replies: list[Reply]
    lengths: Sequence[int]

    @cached_property
    def complete(self) -> bool:
        """Whether every servo brought its data."""
        return all(reply.data is not None for reply in self.replies)

    @cached_property
    def alert(self) -> bool:
        """Whether any servo reports a hardware error."""
        return any(reply.alert for reply in self.replies)

    @cached_property
    def block(self) -> bytes:
        """The data of all servos one behind the other, zeros for those that are missing."""
        return b"".join(
            [
                bytes(length) if reply.data is None else reply.data
                for reply, length in zip(self.replies, self.lengths, strict=True)
            ]
        )


@dataclass(frozen=True, slots=True)
class _Plan:
    """A request, and the replies to it."""

    items: tuple[Item, ...]
    request: bytes
    slots: tuple[Slot, ...]
    fast_request: bytes = b""
    fast_reply: FastReplyParser | None = None
    fast_patience: float = 0.0


class GroupRead:
    """A read of several servos of one protocol; made by `Bus.sync_group`, `bulk_group` or `single_group`.

    Args:
        items: what to read of whom, in the order in which they reply.
        same_range: they are all the same but for the id: a sync read, else a bulk read.
        one_by_one: each is read on its own.
        fast: they reply with one packet between them, while that works.
    """

    def __init__(
        self,
        bus: Bus,
        items: Sequence[Item],
        *,
        same_range: bool = False,
        one_by_one: bool = False,
        fast: bool = False,
    ) -> None:
        self.items = tuple(items)
        self.ids = [item.id for item in items]
        self._bus = bus
        self._protocol = bus.common_protocol(self.ids)
        if self._protocol == 1 and (same_range or fast):
            raise ValueError("protocol 1.0 has no sync read and no fast read")
        self._same_range = same_range
        self._one_by_one = one_by_one
        self._fast = fast
        self._lengths = [item.length for item in items]
        self._plans: dict[tuple[Item, ...], _Plan] = {}
        self._revision = bus.revision
        self._silences = dict.fromkeys(self.ids, 0)
        self._left_out: list[int] = []
        self._asked = self._split(self.items)
        self._cycle = 0
        self._fast_failures = 0
        self._fast_again = 0

    @property
    def is_fast(self) -> bool:
        """Whether the next run is a fast read."""
        return self._fast and self._cycle >= self._fast_again

    @property
    def left_out(self) -> Sequence[int]:
        """Ids of those that are silent and tried only now and then."""
        return tuple(self._left_out)

    def run(self) -> GroupResult:
        """Read once.

        Raises:
            ConnectionLost: the adapter is gone.
        """
        if self._revision != self._bus.revision:
            self._revision = self._bus.revision
            self._plans.clear()
        self._cycle += 1
        found: dict[int, Reply] = {}
        for items in self._asked:
            self._read(items, found)
        if self._left_out or len(found) < len(self.items):
            self._try_left_out(found)
        replies = [found[id] for id in self.ids]
        self._note(replies)
        return GroupResult(replies, self._lengths)

    def _read(self, items: tuple[Item, ...], found: dict[int, Reply]) -> None:
        if self.is_fast:
            items = self._read_fast(items, found)
        gaps = 0
        again = False
        while items:
            plan = self._plan(items)
            replies = self._bus.line.ask(self._protocol, plan.request, plan.slots, again=again)
            found.update({reply.id: reply for reply in replies})
            items = items[len(replies) :]
            again = True
            answered = any(reply.failure is not Failure.SILENT for reply in replies)
            gaps = 0 if answered else gaps + 1
            if gaps == MOST_GAPS:
                found.update({item.id: _silent(item.id) for item in items})
                return

    def _read_fast(self, items: tuple[Item, ...], found: dict[int, Reply]) -> tuple[Item, ...]:
        """Read what can be read at once, and return the items that are missing."""
        plan = self._plan(items)
        assert plan.fast_reply is not None
        blocks = self._bus.line.ask_fast(plan.fast_request, plan.fast_reply, plan.fast_patience)
        missing = []
        for item, block in zip(items, blocks, strict=True):
            counters = self._bus.counters(item.id)
            counters.alerts += block.alert
            if block.data is None:
                counters.corrupt += block.damaged
                missing.append(item)
            elif block.error:
                counters.refused += 1
                found[item.id] = Reply(item.id, None, block.error, block.alert, Failure.REFUSED)
            else:
                counters.replies += 1
                found[item.id] = Reply(item.id, block.data, 0, block.alert)
        if missing:
            self._fast_failures += 1
            if self._fast_failures == FAST_FAILURES:
                self._fast_failures = 0
                self._fast_again = self._cycle + FAST_AGAIN
        else:
            self._fast_failures = 0
        return tuple(missing)

    def _try_left_out(self, found: dict[int, Reply]) -> None:
        if not self._asked or self._cycle % TRY_EVERY == 0:
            id = self._left_out[0]
            self._left_out.append(self._left_out.pop(0))
            plan = self._plan(tuple(item for item in self.items if item.id == id))
            (found[id],) = self._bus.line.ask(self._protocol, plan.request, plan.slots)
        for id in self._left_out:
            found.setdefault(id, Reply(id, None, failure=Failure.LEFT_OUT))

    def _note(self, replies: Sequence[Reply]) -> None:
        """Leave out those who have been silent too often, and ask those again who have answered."""
        changed = False
        for reply in replies:
            id = reply.id
            if reply.failure is Failure.SILENT:
                self._silences[id] += 1
                if self._silences[id] == LEAVE_OUT_AFTER:
                    self._left_out.append(id)
                    changed = True
            elif reply.failure is not Failure.LEFT_OUT and self._silences[id]:
                self._silences[id] = 0
                if id in self._left_out:
                    self._left_out.remove(id)
                    changed = True
        if changed:
            left = [item for item in self.items if item.id not in self._left_out]
            self._asked = self._split(left)
            self._fast_again = self._cycle

    def _split(self, items: Sequence[Item]) -> list[tuple[Item, ...]]:
        """Return what is asked at once."""
        if self._one_by_one:
            return [(item,) for item in items]
        return [tuple(items)] if items else []

    def _plan(self, items: tuple[Item, ...]) -> _Plan:
        plan = self._plans.get(items)
        if plan is None:
            plan = self._plans[items] = self._planned(items)
        return plan

    def _planned(self, items: tuple[Item, ...]) -> _Plan:
        bus = self._bus
        slots = tuple(bus.slot(item.id, item.length) for item in items)
        request = self._request(items)
        if not self._fast:
            return _Plan(items, request, slots)
        reply = FastReplyParser([(item.id, item.length) for item in items])
        delay = max(bus.link(item.id).return_delay for item in items)
        patience = delay + bus.port.wire_time(reply.size) + bus.latency_budget
        return _Plan(items, request, slots, self._fast_request(items), reply, patience)

    def _request(self, items: tuple[Item, ...]) -> bytes:
        first = items[0]
        if self._one_by_one:
            return PROTOCOLS[self._protocol].read(first.id, first.address, first.length)
        if self._same_range:
            return protocol2.sync_read([item.id for item in items], first.address, first.length)
        return PROTOCOLS[self._protocol].bulk_read(items)

    def _fast_request(self, items: tuple[Item, ...]) -> bytes:
        if self._same_range:
            ids = [item.id for item in items]
            return protocol2.fast_sync_read(ids, items[0].address, items[0].length)
        return protocol2.fast_bulk_read(items)


def _silent(id: int) -> Reply:
    return Reply(id, None, failure=Failure.SILENT)


class GroupWrite:
    """A write of the same range of several servos; made by `Bus.write_group`.

    Args:
        ids: in the order in which `run` is given their data.
        address: of the range.
        length: of the range in bytes.
    """

    def __init__(self, bus: Bus, ids: Sequence[int], address: int, length: int) -> None:
        codec = PROTOCOLS[bus.common_protocol(ids)]
        self.ids = tuple(ids)
        self._bus = bus
        self._size = len(ids) * length
        zeros = codec.sync_write(address, length, dict.fromkeys(ids, bytes(length)))
        head = len(zeros) - codec.TAIL - len(ids) * (1 + length)
        self._seal = codec.seal
        self._packet = bytearray(zeros[: -codec.TAIL])
        rows = np.frombuffer(self._packet, np.uint8, offset=head).reshape(len(ids), 1 + length)
        self._values = rows[:, 1:]

    def run(self, data: bytes) -> None:
        """Write; nobody answers.

        Args:
            data: little-endian values of all servos, one behind the other.

        Raises:
            ConnectionLost: the adapter is gone.
        """
        if len(data) != self._size:
            raise ValueError(
                f"{len(data)} bytes given for {len(self.ids)} servos, not {self._size}"
            )
        self._values[:] = np.frombuffer(data, np.uint8).reshape(self._values.shape)
        self._bus.line.send(self._seal(self._packet))
