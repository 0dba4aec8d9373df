"""One request on the wire, and the replies of those it asks, each within a time of its own.

Deadlines are what the wire and the servos need (bytes at the baud rate, return delay) and a budget for
adapter and operating system.

A reply that comes after its request was given up is never taken for one to a newer request, however late it
is (`crtk_driver_dynamixel.owed`). Where the two could not be told apart, the servo is first asked for
something else: nothing is owed any more when that has come, and until then the servo counts as silent.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from crtk_driver_dynamixel import framing, protocol1, protocol2
from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.group_replies import FastReply, PlainReplies, Whole, WholeReply
from crtk_driver_dynamixel.matching import Matcher, Slot
from crtk_driver_dynamixel.owed import Owed
from crtk_driver_dynamixel.protocol2 import BROADCAST
from crtk_driver_dynamixel.protocols import PROTOCOLS
from crtk_driver_dynamixel.replies import Counters, Failure, Reply
from crtk_drivers.kit.serial_port import SerialPort


@dataclass(slots=True)
class LineCounters:
    """What happened on the line since it was made.

    Attributes:
        requests: that were sent.
        garbage: bytes that belonged to no packet.
        bad_crc: damaged packets.
        echoes: of our own requests, which some adapters return.
        strays: replies that nothing had asked for: late, doubled, or of another length.
        probes: times that a servo was asked only to see that no late reply comes any more.
    """

    requests: int = 0
    garbage: int = 0
    bad_crc: int = 0
    echoes: int = 0
    strays: int = 0
    probes: int = 0


PROBED: Final = 0
"""Address from which a probe reads: model number and what follows, in every control table."""
WORTH_SLEEPING: Final = 0.002
"""Seconds of the wire's time from which on replies are looked at only when they can be complete."""


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

    def __init__(self, port: SerialPort, clock: Callable[[], float] = time.monotonic) -> None:
        self.port = port
        self._clock = clock
        self._parsers: Mapping[int, framing.StatusParser] = {
            1: protocol1.StatusParser(longest=0),
            2: protocol2.StatusParser(longest=0),
        }
        self._servos: defaultdict[int, Counters] = defaultdict(Counters)
        self._owed = Owed()
        self._free_at = 0.0
        self._echoing = False
        self._requests = 0
        self._echoes = 0
        self._strays = 0
        self._probes = 0

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
            probes=self._probes,
        )

    def servo(self, id: int) -> Counters:
        """Return the counters of a servo, which go on counting."""
        return self._servos[id]

    def reopened(self) -> None:
        """Forget what was under way, but not what may still come: the port was opened anew."""
        self._free_at = 0.0
        for parser in self._parsers.values():
            parser.finish()

    def forget(self) -> None:
        """Forget what may still come, too: it would come at another rate."""
        self.reopened()
        self._owed = Owed()

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
        whether those behind it would have answered is not known. So it ends, too, if the first one does not
        answer a probe: nothing else is asked of it then.

        Args:
            slots: whose replies are expected, in their order; not empty.
            again: the same was asked just before: a late reply to that is as good.

        Raises:
            ConnectionLost: the adapter is gone.
        """
        if not self._prepare(protocol, slots[0], slots[0].id, again=again):
            return [_silent(slots[0])]
        self.send(request)
        deadline = self._free_at + slots[0].time
        return self._search(protocol, request, slots, b"", deadline, again=again)

    def ask_whole(
        self, request: bytes, slots: Sequence[Slot], replies: PlainReplies
    ) -> Whole | list[Reply]:
        """As `ask` in protocol 2.0, but where all replies come as expected they are taken at once."""
        if not self._prepare(2, slots[0], slots[0].id):
            return [_silent(slots[0])]
        self.send(request)
        deadline = self._free_at + slots[0].time
        if not self._owed.none:
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
        slot = Slot(BROADCAST, reply.data_size, reply.size, patience)
        if not self._prepare(2, slot, reply.ids[0]):
            return [None] * len(reply.ids)
        self.send(request)
        received = self._receive(request, reply, self._free_at + patience, 0.0)
        if received.whole is not None:
            self._owed.answered(again=False)
            self._count_whole(reply.ids, received.whole)
            return received.whole
        _, buffer, deadline, over = received
        start = buffer.find(reply.prefix)
        while not over and (start < 0 or len(buffer) < start + reply.size):
            is_last_look = self._clock() >= deadline
            data = self.port.read(deadline)
            over = not data or is_last_look
            buffer += data
            start = buffer.find(reply.prefix)
        parser.longest = max(parser.longest, len(request), reply.size)
        echoes = parser.echoes
        if start < 0:
            self._stray([*parser.feed(buffer), *parser.finish()])
            self._owed.missed(BROADCAST, reply.data_size)
        else:
            self._owed.answered(again=False)
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

    def _prepare(self, protocol: int, first: Slot, id: int, *, again: bool = False) -> bool:
        """Take what came unasked, and make sure that the first reply cannot be one that is owed.

        Args:
            first: reply to the request.
            id: of the servo to be probed.

        Returns:
            False if the servo does not answer the probe.
        """
        parser = self._parsers[protocol]
        late = self.port.drain()
        if late:
            self._stray([*parser.feed(late), *parser.finish()])
        if not again:
            self._owed.begin()
        if not self._owed.is_ambiguous(first.id, first.length):
            return True
        codec = PROTOCOLS[protocol]
        length = self._owed.probe(id, first.length)
        size = codec.status_size(length)
        slot = replace(
            first, id=id, length=length, size=size, time=first.time + self.port.wire_time(size)
        )
        request = codec.read(id, PROBED, length)
        self.send(request)
        self._probes += 1
        deadline = self._free_at + slot.time
        (reply,) = self._search(protocol, request, [slot], b"", deadline, is_probe=True)
        return reply.data is not None

    def _stray(self, statuses: Sequence[Status]) -> None:
        """Count replies that nothing asked for."""
        self._stray_ids([status.id for status in statuses])

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
        is_probe: bool = False,
    ) -> list[Reply]:
        """Find the replies among whatever else has arrived and arrives.

        Replies that come before there was time for any do not show that those before them are missing.

        Args:
            received: so far.
            deadline: of the next reply.
            over: it has passed.
        """
        owed = self._owed
        is_owed = owed.holds_besides_probes if is_probe else owed.holds
        expected = {(slot.id, slot.length) for slot in slots}
        parser = self._parsers[protocol]
        parser.expect_echo(request)
        parser.corrupt.clear()
        sizes = [slot.size + slot.length // 3 for slot in slots]
        parser.longest = max(parser.longest, len(request), *sizes)
        echoes = parser.echoes
        matcher = Matcher(slots)
        first_due = deadline
        earliest = self._free_at + self.port.wire_time(slots[0].size)
        is_early = certain = has_looked_late = False
        statuses = parser.feed(received)
        while True:
            at = matcher.at
            for status in statuses:
                if not certain and is_owed(status):
                    self._stray([status])
                    continue
                certain = certain or (status.id, len(status.params)) in expected
                self._stray_ids(matcher.place(status))
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
            # One last look, not more: noise that never ends would keep this thread for ever.
            over = over or (has_looked_late and now >= deadline)
            has_looked_late = now >= deadline
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
        if is_probe:
            if certain:
                owed.probed()
            return replies
        if certain:
            owed.answered(again=again)
        for slot in slots[matcher.answered :]:
            owed.missed(slot.id, slot.length)
        return replies

    def _stray_ids(self, ids: Sequence[int]) -> None:
        for id in ids:
            self._strays += 1
            self._servos[id].strays += 1


def _silent(slot: Slot) -> Reply:
    return Reply(slot.id, None, failure=Failure.SILENT)
