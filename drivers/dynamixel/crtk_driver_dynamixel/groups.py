"""Reads and writes of several servos at once, prepared once and run in every cycle.

A servo that is silent costs the time of its own slot: those behind it are asked anew without it, as some
stay silent when the one before them does. After several times in a row it is left out, and tried again
every now and then.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Protocol

from crtk_driver_dynamixel import protocol2
from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.group_replies import FastReply, PlainReplies, Whole
from crtk_driver_dynamixel.line import Line
from crtk_driver_dynamixel.matching import Slot
from crtk_driver_dynamixel.protocols import PROTOCOLS
from crtk_driver_dynamixel.replies import Failure, Reply
from crtk_drivers.kit.serial_port import SerialPort

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


class Way(Protocol):
    """How a servo is spoken to."""

    @property
    def return_delay(self) -> float:
        """Seconds that it waits before it answers."""


class Servos(Protocol):
    """What groups need of the bus.

    Attributes:
        port: of the line.
        line: on which everything is asked.
        revision: changes whenever deadlines do.
    """

    port: SerialPort
    line: Line
    revision: int

    @property
    def latency_budget(self) -> float:
        """Seconds allowed to adapter and operating system."""

    def common_protocol(self, ids: Sequence[int]) -> int:
        """Return the protocol of servos.

        Raises:
            ValueError: they do not have the same.
        """

    def link(self, id: int) -> Way:
        """Return how a servo is spoken to."""

    def slot(self, id: int, length: int) -> Slot:
        """Return the reply with `length` bytes that is expected of a servo."""


class Item(NamedTuple):
    """What to read of one servo."""

    id: int
    address: int
    length: int


class GroupResult:
    """The replies of a group, in its order.

    Attributes:
        complete: whether every servo brought its data.
        data: of each servo, None where it is missing.
    """

    __slots__ = ("_ids", "_lengths", "_replies", "_whole", "complete", "data")

    def __init__(
        self, ids: Sequence[int], lengths: Sequence[int], found: Whole | list[Reply]
    ) -> None:
        self._ids = ids
        self._lengths = lengths
        self._whole: Whole | None = None
        self._replies: list[Reply] = []
        self.data: Sequence[bytes | None]
        if isinstance(found, Whole):
            self._whole = found
            self.data = found.data
            self.complete = True
        else:
            self._replies = found
            self.data = [reply.data for reply in found]
            self.complete = None not in self.data

    @property
    def replies(self) -> list[Reply]:
        """One for each servo, with its data or the reason why there are none."""
        if self._whole is not None and not self._replies:
            triples = zip(self._ids, *self._whole, strict=True)
            self._replies = [Reply(id, data, 0, alert != 0) for id, data, alert in triples]
        return self._replies

    @property
    def at_once(self) -> bool:
        """Whether all replies came as expected and were taken at once, rather than searched for."""
        return self._whole is not None

    @property
    def alert(self) -> bool:
        """Whether any servo reports a hardware error."""
        if self._whole is not None:
            return any(self._whole.alerts)
        return any(reply.alert for reply in self._replies)

    @property
    def block(self) -> bytes:
        """The data of all servos one behind the other, zeros where they are missing."""
        if self._whole is not None:
            return b"".join(self._whole.data)
        pairs = zip(self.data, self._lengths, strict=True)
        return b"".join([bytes(length) if data is None else data for data, length in pairs])


@dataclass(frozen=True, slots=True)
class _Plan:
    """How some of the servos are asked at once."""

    items: tuple[Item, ...]
    request: bytes
    slots: tuple[Slot, ...]
    whole: PlainReplies
    fast_request: bytes = b""
    fast_reply: FastReply | None = None
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
        bus: Servos,
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
        self._absences = Absences()
        self._present: Sequence[Item] = self.items
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
        return tuple(self._absences.left_out)

    def run(self) -> GroupResult:
        """Read once.

        Raises:
            ConnectionLost: the adapter is gone.
        """
        if self._revision != self._bus.revision:
            self._revision = self._bus.revision
            self._plans.clear()
            self._asked = self._split(self._present)
        self._cycle += 1
        read = self._read_fast if self._fast and self.is_fast else self._read_plain
        if len(self._asked) == 1 and len(self._present) == len(self.items):
            found = read(self._asked[0])
        else:
            found = self._with_left_out(
                [reply for plan in self._asked for reply in _replies(plan.items, read(plan))]
            )
        result = GroupResult(self.ids, self._lengths, found)
        if not (result.complete and self._absences.none):
            self._note(result.replies)
        return result

    def _read_fast(self, plan: _Plan) -> Whole | list[Reply]:
        """Read what can be read at once, and the rest one behind the other."""
        assert plan.fast_reply is not None
        found = self._bus.line.ask_fast(plan.fast_request, plan.fast_reply, plan.fast_patience)
        if isinstance(found, Whole):
            self._fast_failures = 0
            return found
        self._fast_failures += 1
        if self._fast_failures == FAST_FAILURES:
            self._fast_failures = 0
            self._fast_again = self._cycle + FAST_AGAIN
        pairs = list(zip(plan.items, found, strict=True))
        missing = tuple(item for item, block in pairs if block is None)
        rest = iter(_replies(missing, self._read_plain(self._plan(missing))) if missing else ())
        return [next(rest) if block is None else _reply(block) for _, block in pairs]

    def _read_plain(self, plan: _Plan) -> Whole | list[Reply]:
        items = plan.items
        line = self._bus.line
        if self._protocol == 2:
            found = line.ask_whole(plan.request, plan.slots, plan.whole)
            if isinstance(found, Whole):
                return found
        else:
            found = line.ask(self._protocol, plan.request, plan.slots)
        gaps = 1
        while len(found) < len(items):
            if gaps == MOST_GAPS:
                rest = items[len(found) :]
                return found + [_missing(item.id) for item in rest]
            plan = self._plan(items[len(found) :])
            more = line.ask(self._protocol, plan.request, plan.slots, again=True)
            found += more
            gaps = gaps + 1 if len(more) == 1 else 1
        return found

    def _with_left_out(self, replies: Sequence[Reply]) -> list[Reply]:
        """Return the replies with those of the servos that are left out; one of them is tried at times."""
        found = {reply.id: reply for reply in replies}
        if self._absences.left_out and (not found or self._cycle % TRY_EVERY == 0):
            id = self._absences.next()
            plan = self._plan(tuple(item for item in self.items if item.id == id))
            (found[id],) = self._bus.line.ask(self._protocol, plan.request, plan.slots)
        return [found.get(id) or _missing(id) for id in self.ids]

    def _note(self, replies: Sequence[Reply]) -> None:
        if self._absences.note(replies):
            left_out = self._absences.left_out
            self._present = [item for item in self.items if item.id not in left_out]
            self._asked = self._split(self._present)
            self._fast_again = self._cycle

    def _split(self, items: Sequence[Item]) -> list[_Plan]:
        """Return how servos are asked: all at once, or one by one."""
        if self._one_by_one:
            return [self._plan((item,)) for item in items]
        return [self._plan(tuple(items))] if items else []

    def _plan(self, items: tuple[Item, ...]) -> _Plan:
        plan = self._plans.get(items)
        if plan is None:
            plan = self._plans[items] = self._planned(items)
        return plan

    def _planned(self, items: tuple[Item, ...]) -> _Plan:
        bus = self._bus
        slots = tuple(bus.slot(item.id, item.length) for item in items)
        blocks = [(item.id, item.length) for item in items]
        plan = _Plan(items, self._request(items), slots, PlainReplies(blocks))
        if not self._fast:
            return plan
        reply = FastReply(blocks)
        delay = max(bus.link(item.id).return_delay for item in items)
        return replace(
            plan,
            fast_request=self._fast_request(items),
            fast_reply=reply,
            fast_patience=delay + bus.port.wire_time(reply.size) + bus.latency_budget,
        )

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


def _replies(items: Sequence[Item], found: Whole | list[Reply]) -> list[Reply]:
    if isinstance(found, Whole):
        return GroupResult([item.id for item in items], (), found).replies
    return found


def _missing(id: int) -> Reply:
    return Reply(id, None, failure=Failure.LEFT_OUT)


def _reply(block: Status) -> Reply:
    if block.error:
        return Reply(block.id, None, block.error, block.alert, Failure.REFUSED)
    return Reply(block.id, block.params, 0, block.alert)


class Absences:
    """Who is silent again and again. Pure: no I/O, no clock.

    Attributes:
        left_out: ids of those that were silent too often, in the order in which they are tried.
    """

    def __init__(self) -> None:
        self.left_out: list[int] = []
        self._silences: dict[int, int] = {}

    @property
    def none(self) -> bool:
        """Whether nobody was silent the last time."""
        return not self._silences

    def next(self) -> int:
        """Return the id of the one to try now."""
        id = self.left_out.pop(0)
        self.left_out.append(id)
        return id

    def note(self, replies: Sequence[Reply]) -> bool:
        """Take what came of one cycle; return whether `left_out` has others now."""
        before = set(self.left_out)
        back = {reply.id for reply in replies if reply.data is not None} & before
        if back:
            # What kept one from answering may have kept the others: once more silent, and they are out again.
            self._silences |= dict.fromkeys(before - back, LEAVE_OUT_AFTER - 1)
            self.left_out.clear()
        for id, _, _, _, failure, _ in replies:
            if failure is Failure.LEFT_OUT:
                continue
            if failure is not Failure.SILENT:
                self._silences.pop(id, None)
                if id in self.left_out:
                    self.left_out.remove(id)
                continue
            self._silences[id] = self._silences.get(id, 0) + 1
            if self._silences[id] == LEAVE_OUT_AFTER:
                self.left_out.append(id)
        return set(self.left_out) != before


class GroupWrite:
    """A write of the same range of several servos; made by `Bus.write_group`.

    Args:
        ids: in the order in which `run` is given their data.
        address: of the range.
        length: of the range in bytes.
    """

    def __init__(self, bus: Servos, ids: Sequence[int], address: int, length: int) -> None:
        codec = PROTOCOLS[bus.common_protocol(ids)]
        self.ids = tuple(ids)
        self._bus = bus
        self._size = len(ids) * length
        zeros = codec.sync_write(address, length, dict.fromkeys(ids, bytes(length)))
        head = zeros[: len(zeros) - codec.TAIL - len(ids) * (1 + length)]
        self._seal = codec.seal
        self._split = struct.Struct(f"{length}s" * len(ids)).unpack
        self._parts = [head]
        for id in ids:
            self._parts += [bytes((id,)), b""]

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
        self._parts[2::2] = self._split(data)
        self._bus.line.send(self._seal(b"".join(self._parts)))
