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
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from crtk_driver_dynamixel import framing, protocol1, protocol2
from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.group_replies import FastReply, PlainReplies, Whole, WholeReply
from crtk_driver_dynamixel.matching import Matcher, Slot
from crtk_driver_dynamixel.port import Port
from crtk_driver_dynamixel.protocol2 import BROADCAST
from crtk_driver_dynamixel.replies import Counters, Reply

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


WORTH_SLEEPING: Final = 0.002
"""Seconds of the wire's time from which on replies are looked at only when they can be complete."""


class _Owed(NamedTuple):
    id: int
    length: int
    until: float


class _Received(NamedTuple):
    whole: Whole | None
    buffer: bytes
    deadline: float
    over: bool


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
            1: protocol1.StatusParser(longest=0),
            2: protocol2.StatusParser(longest=0),
        }
        self._servos: defaultdict[int, Counters] = defaultdict(Counters)
        self._owed: list[_Owed] = []
        self._free_at = 0.0
        self._echoing = False
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
        return self._servos[id]

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
        self._prepare(self._parsers[protocol], slots[0].id, slots[0].length, again=again)
        self.send(request)
        deadline = self._free_at + slots[0].time
        return self._search(protocol, request, slots, b"", deadline, again=again)

    def ask_whole(
        self, request: bytes, slots: Sequence[Slot], replies: PlainReplies
    ) -> Whole | list[Reply]:
        """As `ask` in protocol 2.0, but where all replies come as expected they are taken at once."""
        self._prepare(self._parsers[2], slots[0].id, slots[0].length, again=False)
        self.send(request)
        deadline = self._free_at + slots[0].time
        if self._owed:
            return self._search(2, request, slots, b"", deadline)
        received = self._receive(request, replies, deadline, slots[-1].time)
        if received.whole is not None:
            self._count_whole(replies.ids, received.whole)
            return received.whole
        return self._search(2, request, slots, *received[1:])

    def ask_fast(
        self, request: bytes, reply: FastReply, patience: float
    ) -> Whole | list[Status | None]:
        """Send a fast read and return the block of each servo, None where it is damaged or missing.

        Args:
            patience: seconds in which the whole reply comes after the request.

        Raises:
            ConnectionLost: the adapter is gone.
        """
        parser = self._parsers[2]
        self._prepare(parser, BROADCAST, reply.data_size, again=False)
        self.send(request)
        received = self._receive(request, reply, self._free_at + patience, 0.0)
        if received.whole is not None:
            self._owed.clear()
            self._count_whole(reply.ids, received.whole)
            return received.whole
        _, buffer, deadline, over = received
        start = buffer.find(reply.prefix)
        while not over and (start < 0 or len(buffer) < start + reply.size):
            data = self.port.read(deadline)
            over = not data
            buffer += data
            start = buffer.find(reply.prefix)
        parser.longest = max(parser.longest, len(request), reply.size)
        echoes = parser.echoes
        if start < 0:
            self._stray([*parser.feed(buffer), *parser.finish()])
            self._owed.append(_Owed(BROADCAST, reply.data_size, deadline + LATEST))
        else:
            self._owed.clear()
            for around in (buffer[:start], buffer[start + reply.size :]):
                self._stray([*parser.feed(around), *parser.finish()])
        self._echoing = parser.echoes > echoes
        blocks = reply.blocks(buffer[start : start + reply.size] if start >= 0 else b"")
        for id, block in zip(reply.ids, blocks, strict=True):
            if block is not None:
                self._servos[id].take(error=block.error, alert=block.alert)
        return blocks

    def _receive(
        self, request: bytes, reply: WholeReply, deadline: float, patience: float
    ) -> _Received:
        """Receive as much as a whole reply has, as long as it looks like one.

        Adapters hand over in pieces what takes long; there is no use in waking up for each of them.

        Args:
            patience: seconds for more to come, once something has come.
        """
        skip = len(request) if self._echoing else 0
        size = skip + reply.size
        pause = self._free_at + self.port.wire_time(reply.size) - self._clock()
        if pause > WORTH_SLEEPING:
            time.sleep(pause)
        buffer = self.port.read(deadline)
        over = not buffer
        while not over and len(buffer) < size and reply.fits(buffer[skip:]):
            deadline = max(deadline, self._clock() + patience)
            data = self.port.read(deadline)
            over = not data
            buffer += data
        whole = None
        if len(buffer) == size:
            if not skip:
                whole = reply.whole(buffer)
            elif buffer.startswith(request):
                whole = reply.whole(buffer[skip:])
                self._echoes += whole is not None
        return _Received(whole, buffer, deadline, over)

    def _count_whole(self, ids: Sequence[int], whole: Whole) -> None:
        servos = self._servos
        for id in ids:
            servos[id].replies += 1
        if any(whole.alerts):
            for id, alert in zip(ids, whole.alerts, strict=True):
                servos[id].alerts += alert != 0

    def _prepare(
        self, parser: framing.StatusParser, first: int, length: int, *, again: bool
    ) -> None:
        """Take what came unasked, and let the line fall quiet if the first reply could be an owed one."""
        late = self.port.drain()
        if late:
            self._stray([*parser.feed(late), *parser.finish()])
        if self._owed and not again:
            self._settle(parser, first, length)

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
            self._settle_owed(status)

    def _settle_owed(self, status: Status) -> None:
        index = self._owes(status)
        if index is not None:
            del self._owed[: index + 1]

    def _search(
        self,
        protocol: int,
        request: bytes,
        slots: Sequence[Slot],
        received: bytes,
        deadline: float,
        over: bool = False,
        *,
        again: bool = False,
    ) -> list[Reply]:
        """Find the replies among whatever else has arrived and arrives.

        Replies that come before there was time for any do not show that those before them are missing.

        Args:
            received: so far.
            deadline: of the next reply.
            over: it has passed.
        """
        parser = self._parsers[protocol]
        parser.expect_echo(request)
        parser.corrupt.clear()
        sizes = [slot.size + slot.length // 3 for slot in slots]
        parser.longest = max(parser.longest, len(request), *sizes)
        echoes = parser.echoes
        matcher = Matcher(slots)
        first_due = deadline
        earliest = self._free_at + self.port.wire_time(slots[0].size)
        is_early = certain = False
        statuses = parser.feed(received)
        while True:
            at = matcher.at
            for status in statuses:
                if not (again or certain) and self._owes(status) is not None:
                    self._stray([status])
                    continue
                certain = True
                strays = matcher.place(status)
                if strays:
                    self._stray_ids(strays)
                    self._settle_owed(status)
            if matcher.complete:
                break
            now = self._clock()
            is_early = is_early or (now < earliest and matcher.at != at)
            if matcher.done:
                # Not the end, if nobody can have answered yet: it was left over from before.
                if not is_early:
                    break
                deadline = first_due
            elif matcher.at != at:
                deadline = now + slots[matcher.at].time
            data = b"" if over else self.port.read(deadline)
            over = not data
            statuses = parser.finish() if over else parser.feed(data)
            if over and not statuses:
                break
        self._stray(parser.finish())
        self._echoing = protocol == 2 and parser.echoes > echoes
        replies = matcher.replies(parser.corrupt)
        for reply in replies:
            self._servos[reply.id].take(reply.failure, error=reply.error, alert=reply.alert)
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
            self._servos[id].strays += 1
