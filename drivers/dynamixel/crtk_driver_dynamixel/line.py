"""One request on the wire, and the replies of those it asks, each within a time of its own.

Deadlines are what the wire and the servos need (bytes at the baud rate, return delay) and a budget for
adapter and operating system.

Bytes arrive in the order in which they were sent, however late: a reply that an earlier request was left
owing comes before any to a newer one, and is dropped. Where the first reply to a new request could not be
told from an owed one, the line is first left quiet until no such reply can come any more. What is later
than `LATEST` cannot be recognised.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from crtk_driver_dynamixel import framing, protocol1, protocol2
from crtk_driver_dynamixel.crc import crc16
from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.matching import Matcher, Slot
from crtk_driver_dynamixel.port import Port
from crtk_driver_dynamixel.protocol2 import ALERT, BROADCAST, SEQUENCE, Block, FastReplyParser
from crtk_driver_dynamixel.replies import Counters, Failure, Reply

__all__ = ["LATEST", "Line", "LineCounters"]

LATEST: Final = 0.02
"""Seconds past its deadline after which a reply does not come any more: an adapter holds it 16 ms at most."""


@dataclass(slots=True)
class LineCounters:
    """What happened on the line since it was made.

    Attributes:
        requests: that were sent.
        garbage: bytes that belonged to no packet.
        bad_crc: damaged packets.
        echoes: of our own requests, which some adapters return.
        strays: replies that nothing had asked for: late, doubled, or of another length.
        waits: times that the line was left quiet for late replies.
    """

    requests: int = 0
    garbage: int = 0
    bad_crc: int = 0
    echoes: int = 0
    strays: int = 0
    waits: int = 0


class _Owed(NamedTuple):
    id: int
    length: int
    until: float


class Line:
    """The transactions of one port. Not thread-safe: it belongs to one thread.

    Args:
        port: open whenever the line is used.
        clock: monotonic seconds.
    """

    def __init__(self, port: Port, clock: Callable[[], float] = time.monotonic) -> None:
        self.port = port
        self._clock = clock
        self._parsers: Mapping[int, framing.StatusParser] = {
            1: protocol1.StatusParser(),
            2: protocol2.StatusParser(),
        }
        self._servos: dict[int, Counters] = {}
        self._owed: list[_Owed] = []
        self._free_at = 0.0
        self._requests = 0
        self._echoes = 0
        self._strays = 0
        self._waits = 0

    @property
    def counters(self) -> LineCounters:
        """What has happened so far."""
        parsers = self._parsers.values()
        return LineCounters(
            requests=self._requests,
            garbage=sum(parser.garbage for parser in parsers),
            bad_crc=sum(parser.bad_crc for parser in parsers),
            echoes=self._echoes + sum(parser.echoes for parser in parsers),
            strays=self._strays,
            waits=self._waits,
        )

    def servo(self, id: int) -> Counters:
        """Return the counters of a servo, which go on counting."""
        found = self._servos.get(id)
        if found is None:
            found = self._servos[id] = Counters()
        return found

    def forget(self) -> None:
        """Forget what was under way: the port was opened anew."""
        self._owed.clear()
        self._free_at = 0.0
        for parser in self._parsers.values():
            parser.finish()

    def send(self, request: bytes) -> None:
        """Send what nobody replies to.

        Raises:
            ConnectionLost: the adapter is gone.
        """
        self._requests += 1
        self.port.write(request)
        self._free_at = max(self._free_at, self._clock()) + self.port.wire_time(len(request))

    def ask(
        self, protocol: int, request: bytes, slots: Sequence[Slot], *, again: bool = False
    ) -> list[Reply]:
        """Send a request and return the replies, in the order of `slots`.

        It ends when a servo lets its time pass without a reply: that one is then the last of the list, and
        whether those behind it would have answered is not known.

        Args:
            slots: whose replies are expected, in their order; not empty.
            again: the same was asked just before: a late reply to that is as good.

        Raises:
            ConnectionLost: the adapter is gone.
        """
        parser = self._parsers[protocol]
        self._prepare(parser, slots[0].id, slots[0].length, again=again)
        parser.expect_echo(request)
        parser.longest = max(len(request), *(slot.size + slot.length // 3 for slot in slots))
        self.send(request)
        replies: list[Reply] = []
        rest = b""
        deadline = self._free_at + slots[0].time
        if protocol == 2 and not self._owed:
            rest, deadline = self._clean(request, slots, replies, deadline)
            if len(replies) == len(slots):
                self._stray(parser.feed(rest))
                return replies
        return self._search(parser, slots, replies, rest, deadline, again=again)

    def ask_fast(self, request: bytes, reply: FastReplyParser, patience: float) -> list[Block]:
        """Send a fast read and return the block of each servo, in the order of the request.

        Args:
            patience: seconds in which the whole reply comes after the request.

        Raises:
            ConnectionLost: the adapter is gone.
        """
        parser = self._parsers[2]
        self._prepare(parser, BROADCAST, reply.data_size, again=False)
        parser.longest = max(len(request), reply.size)
        self.send(request)
        deadline = self._free_at + patience
        buffer = b""
        start = -1
        while start < 0 or len(buffer) - start < reply.size:
            data = self.port.read(deadline)
            if not data:
                break
            buffer += data
            if start < 0:
                start = buffer.find(reply.prefix)
        if start < 0:
            self._stray(parser.feed(buffer))
            self._stray(parser.finish())
            self._owed.append(_Owed(BROADCAST, reply.data_size, deadline + LATEST))
            return reply.decode(b"")
        self._owed.clear()
        end = start + reply.size
        for around in (buffer[:start], buffer[end:]):
            if around:
                self._stray(parser.feed(around))
                self._stray(parser.finish())
        return reply.decode(buffer[start:end])

    def _prepare(
        self, parser: framing.StatusParser, first: int, length: int, *, again: bool
    ) -> None:
        """Take what came unasked, and let the line fall quiet if the first reply could be an owed one."""
        late = self.port.drain()
        if late or parser.pending:
            self._stray(parser.feed(late))
            self._stray(parser.finish())
        if self._owed and not again:
            self._settle(parser, first, length)
        parser.corrupt.clear()

    def _settle(self, parser: framing.StatusParser, first: int, length: int) -> None:
        begin = now = self._clock()
        while now < (until := self._owed_until(first, length)):
            self._stray(parser.feed(self.port.read(until)))
            now = self._clock()
        if now > begin:
            self._waits += 1
            self._stray(parser.finish())
        self._owed = [owed for owed in self._owed if owed.until > now]

    def _owed_until(self, id: int, length: int) -> float:
        return max((o.until for o in self._owed if o.id == id and o.length == length), default=0.0)

    def _owes(self, status: Status) -> int | None:
        """Return the index in `_owed` of the reply that this one can be."""
        for index, owed in enumerate(self._owed):
            if owed.id == status.id and (status.error or owed.length == len(status.params)):
                return index
        return None

    def _stray(self, statuses: Sequence[Status]) -> None:
        """Count replies that nothing asked for; what was owed up to them is owed no more."""
        for status in statuses:
            self._stray_ids([status.id])
            index = self._owes(status)
            if index is not None:
                del self._owed[: index + 1]

    def _clean(
        self, request: bytes, slots: Sequence[Slot], replies: list[Reply], deadline: float
    ) -> tuple[bytes, float]:
        """Take whole, undamaged, unstuffed replies in their order: as nearly all of them come.

        Returns:
            What arrived behind them, and when the next reply is due.
        """
        buffer = b""
        position = 0
        for slot in slots:
            prefix, end = slot.prefix, position + slot.size
            is_due = not replies
            while len(buffer) < end or not buffer.startswith(prefix, position):
                buffer, position, end = buffer[position:], 0, slot.size
                if not is_due:
                    deadline, is_due = self._clock() + slot.time, True
                if buffer and not replies and request.startswith(buffer[: len(request)]):
                    if len(buffer) >= len(request):
                        self._echoes += 1
                        position, end = len(request), len(request) + slot.size
                        continue
                elif not prefix.startswith(buffer[: len(prefix)]):
                    return buffer, deadline
                data = self.port.read(deadline)
                if not data:
                    return buffer, deadline
                buffer += data
            packet = buffer[position:end]
            if (
                packet[8] & ~ALERT
                or SEQUENCE in packet[9:-2]
                or crc16(packet[:-2]) != packet[-2] | packet[-1] << 8
            ):
                return buffer[position:], deadline if is_due else self._clock() + slot.time
            reply = Reply(slot.id, packet[9:-2], 0, packet[8] != 0)
            self._count(reply)
            replies.append(reply)
            position = end
        return buffer[position:], deadline

    def _search(
        self,
        parser: framing.StatusParser,
        slots: Sequence[Slot],
        clean: Sequence[Reply],
        rest: bytes,
        deadline: float,
        *,
        again: bool,
    ) -> list[Reply]:
        """Find the remaining replies among whatever else arrives."""
        matcher = Matcher(slots, clean)
        earliest = self._free_at + self.port.wire_time(min(slot.size for slot in slots))
        certain = bool(clean)
        statuses = parser.feed(rest)
        while True:
            at = matcher.at
            for status in statuses:
                if not (again or certain) and self._owes(status) is not None:
                    self._stray([status])
                    continue
                certain = True
                self._stray_ids(matcher.place(status, early=self._clock() < earliest))
            if matcher.done:
                break
            if matcher.at != at:
                deadline = self._clock() + slots[matcher.at].time
            data = self.port.read(deadline)
            statuses = parser.feed(data) if data else parser.finish()
            if not data and not statuses:
                break
        replies = matcher.replies(parser.corrupt)
        for reply in replies[len(clean) :]:
            self._count(reply)
        if certain and not again:
            self._owed.clear()
        self._owed += [
            _Owed(slot.id, slot.length, deadline + LATEST)
            for slot in slots[matcher.answered :]
            if slot.id not in parser.corrupt
        ]
        return replies

    def _stray_ids(self, ids: Sequence[int]) -> None:
        for id in ids:
            self._strays += 1
            self.servo(id).strays += 1

    def _count(self, reply: Reply) -> None:
        counters = self.servo(reply.id)
        if reply.failure is None:
            counters.replies += 1
        elif reply.failure is Failure.REFUSED:
            counters.replies += 1
            counters.refused += 1
        elif reply.failure is Failure.CORRUPT:
            counters.corrupt += 1
        else:
            counters.timeouts += 1
        if reply.alert:
            counters.alerts += 1
