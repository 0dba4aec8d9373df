"""DDS between the processes of a world: writers and readers of topics, and the links between them.

It behaves as Fast DDS 2.14 with rmw_fastrtps does, as far as a program notices: each side finds the other at
a moment of its own; a heartbeat makes a reader request what was lost; a reader and a writer keep the newest
messages only; a process that dies is missed after its lease. See the DDSI-RTPS specification 2.5, 8.4
(reliability) and 8.5 (discovery), and Fast DDS' documentation of their times.
"""

from __future__ import annotations

import itertools
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Protocol

from typing_extensions import override

from crtk_drivers.testing.world.machine.endpoints import network
from crtk_drivers.testing.world.machine.kernel import EPOCH, Waiters, here

HEARTBEAT: Final = 3.0
"""s between the heartbeats of a writer that misses an acknowledgement (Fast DDS, heartbeatPeriod)."""

Listener = Callable[[], object]


class Owner(Protocol):
    """Who has endpoints: a participant.

    Attributes:
        prefix: twelve bytes, the beginning of the ids of its endpoints.
        numbers: of its endpoints.
    """

    prefix: bytes
    numbers: itertools.count[int]

    def add(self, endpoint: Endpoint, /) -> None:
        """Add an endpoint, and announce it."""

    def remove(self, endpoint: Endpoint, /) -> None:
        """Remove an endpoint, and announce that."""

    def do(self, work: Listener, /) -> None:
        """Let its threads do something."""

    def send(self, to: Any, then: Listener, /) -> None:
        """Let a datagram go to another owner, which then does something."""


@dataclass(frozen=True)
class Quality:
    """Quality of service.

    Attributes:
        depth: messages that are kept.
        is_reliable: what is lost is sent again.
        is_latched: TRANSIENT_LOCAL: who comes later is sent what is kept.
    """

    depth: int
    is_reliable: bool
    is_latched: bool


class Sample(NamedTuple):
    """A message.

    Attributes:
        number: of its writer's, from 1 on.
        data: as CDR.
        sent_ns: by the wall clock.
        related: of a request or its response: the id of the client, and the number of the request.
    """

    number: int
    data: bytes
    sent_ns: int
    related: tuple[bytes, int] | None = None


class Taken(NamedTuple):
    """A message that a reader has.

    Attributes:
        sample: it.
        gid: of its writer.
        received_ns: by the wall clock.
    """

    sample: Sample
    gid: bytes
    received_ns: int


def wall_ns() -> int:
    """Return the wall clock, ns since the epoch; looking takes no time."""
    kernel = here()
    return EPOCH + kernel.now + kernel.wall_offset


class Endpoint:
    """A writer or a reader.

    Attributes:
        owner: its participant.
        node: name and namespace of its node.
        topic: as DDS has it: ``rt/``, ``rq/`` or ``rr/`` and the ROS name.
        kind: name of the type of its messages.
        details: what the graph tells of it besides.
        gid: 16 bytes, of which the first twelve are those of its participant.
        listeners: called when something has changed, in no task.
        waiters: tasks that wait for that.
        refused: for each endpoint of the other side that does not match, the policy that differs.
        found: how many of the other side were found, those that have gone among them.
        gone: how many of these have gone.
    """

    def __init__(
        self,
        owner: Owner,
        node: tuple[str, str],
        topic: str,
        kind: str,
        quality: Quality,
        details: Any = None,
    ) -> None:
        self.owner: Any = owner  # an `Owner`, which its own kind compares with itself
        self.node = node
        self.topic = topic
        self.kind = kind
        self.quality = quality
        self.details = details
        self.gid = owner.prefix + struct.pack(">I", next(owner.numbers))
        self.listeners: list[Listener] = []
        self.waiters: Waiters = {}
        self.refused: list[str] = []
        self.found = self.gone = 0
        self.is_open = True
        owner.add(self)

    @property
    def count(self) -> int:
        """How many of the other side it has found."""
        raise NotImplementedError

    def meet(self, other: Endpoint) -> None:
        """Match an endpoint of the other side."""
        raise NotImplementedError

    def part(self, other: Endpoint) -> None:
        """Forget an endpoint of the other side."""
        raise NotImplementedError

    def fits(self, other: Endpoint) -> bool:
        """Whether it is of the same topic, on the other side, and wants no more than is offered."""
        if other.topic != self.topic or type(other) is type(self) or other.kind != self.kind:
            return False
        writer, reader = (self, other) if isinstance(self, Writer) else (other, self)
        policy = (
            "reliability"
            if reader.quality.is_reliable and not writer.quality.is_reliable
            else "durability"
            if reader.quality.is_latched and not writer.quality.is_latched
            else ""
        )
        if policy:
            self.refused.append(policy)
            self.changed()
        return not policy

    def changed(self) -> None:
        """Wake the tasks that wait, and call the listeners."""
        here().wake(self.waiters)
        for listener in tuple(self.listeners):
            listener()

    def close(self) -> None:
        """Close it."""
        if self.is_open:
            self.is_open = False
            self.owner.remove(self)


class Writer(Endpoint):
    """Sends to each reader that it has found."""

    def __init__(self, *given: Any, **more: Any) -> None:
        self.links: dict[Reader, Link] = {}
        self.history: deque[Sample] = deque()
        self.number = 0
        super().__init__(*given, **more)

    @property
    @override
    def count(self) -> int:
        """How many readers it has found."""
        return len(self.links)

    @override
    def meet(self, other: Endpoint) -> None:
        """Begin to send to a reader."""
        assert isinstance(other, Reader)
        if other in self.links:
            return
        keeps = self.quality.is_latched and other.quality.is_latched
        first = self.history[0].number if keeps and self.history else self.number + 1
        self.links[other] = link = Link(self, other, first)
        self.found += 1
        self.changed()
        if first <= self.number:
            for sample in self.history:
                link.send(sample)
            link.beat()

    @override
    def part(self, other: Endpoint) -> None:
        """Send to a reader no more."""
        if isinstance(other, Reader) and self.links.pop(other, None) is not None:
            self.gone += 1
            self.changed()

    def publish(self, data: bytes, related: tuple[bytes, int] | None = None) -> int:
        """Send a message; return its number."""
        here().read_clock()  # it takes some time: no two have the same stamp
        self.number += 1
        sample = Sample(self.number, data, wall_ns(), related)
        self.history.append(sample)
        if len(self.history) > self.quality.depth:
            self.history.popleft()
        here().note("dds", self.topic, self.number, data)
        network().packets += 1
        is_full = len(self.history) == self.quality.depth
        for link in self.links.values():
            link.send(sample)
            if is_full:
                link.beat()
        if not self.links:
            self.forget_acknowledged()
        return self.number

    def hear_of(self, reader: Reader) -> None:
        """Be asked by a reader that has just found this writer what there is (a preemptive ACKNACK)."""

        def answer() -> None:
            if (link := self.links.get(reader)) is not None and link.acknowledged < self.number:
                link.beat()

        reader.owner.send(self.owner, answer)

    def forget_acknowledged(self) -> None:
        """Drop from the history what all readers have, unless somebody who comes later is sent it."""
        if not self.quality.is_latched:
            done = min((link.acknowledged for link in self.links.values()), default=self.number)
            while self.history and self.history[0].number <= done:
                self.history.popleft()

    @property
    def is_acknowledged(self) -> bool:
        """Whether all reliable readers have acknowledged all."""
        return all(link.acknowledged >= self.number for link in self.links.values())


class Reader(Endpoint):
    """Keeps the newest messages of all writers that it has found, until they are taken.

    Attributes:
        cache: what nobody has taken.
        writers: that it has found.
        lost: how many messages have not come, and will not.
        only_for: the id of the client whose answers these are; empty: all is for this reader.
    """

    def __init__(self, *given: Any, **more: Any) -> None:
        self.cache: deque[Taken] = deque()
        self.writers: dict[Writer, None] = {}
        self.only_for = b""
        self.lost = 0
        super().__init__(*given, **more)

    @property
    @override
    def count(self) -> int:
        """How many writers it has found."""
        return len(self.writers)

    @override
    def meet(self, other: Endpoint) -> None:
        """Begin to hear a writer."""
        assert isinstance(other, Writer)
        if other not in self.writers:
            self.writers[other] = None
            self.found += 1
            self.changed()
            other.hear_of(self)

    @override
    def part(self, other: Endpoint) -> None:
        """Hear a writer no more."""
        if isinstance(other, Writer) and other in self.writers:
            del self.writers[other]
            self.gone += 1
            self.changed()

    def deliver(self, sample: Sample, gid: bytes) -> None:
        """Keep a message; the oldest makes room for it."""
        if self.only_for and sample.related is not None and sample.related[0] != self.only_for:
            return  # the answer to another client
        if len(self.cache) >= self.quality.depth:
            self.cache.popleft()
        self.cache.append(Taken(sample, gid, wall_ns()))
        self.changed()

    def take(self) -> Taken | None:
        """Return the oldest message, once."""
        return self.cache.popleft() if self.cache else None


@dataclass
class Link:
    """The way from a writer to a reader.

    Attributes:
        expected: number of the message that the reader waits for.
        acknowledged: number up to which the writer knows that all has come, or will not.
    """

    writer: Writer
    reader: Reader
    expected: int
    acknowledged: int = field(init=False)
    waiting: dict[int, Sample] = field(default_factory=dict)
    is_beating: bool = False

    def __post_init__(self) -> None:
        self.acknowledged = self.expected - 1
        self.is_reliable = self.writer.quality.is_reliable and self.reader.quality.is_reliable
        if not self.is_reliable:
            self.acknowledged = 1 << 62

    def send(self, sample: Sample) -> None:
        """Put a message on its way."""
        self._go(self.reader.owner, lambda: self._arrive(sample))
        self._beat_later()

    def _go(self, to: Owner, then: Listener) -> None:
        """Let a datagram go to a participant."""
        (self.writer if to is self.reader.owner else self.reader).owner.send(to, then)

    def _arrive(self, sample: Sample) -> None:
        reader, number = self.reader, sample.number
        if not reader.is_open or self.writer not in reader.writers or number < self.expected:
            return
        if not self.is_reliable:
            self.expected = number + 1
            reader.deliver(sample, self.writer.gid)
            return
        self.waiting[number] = sample
        self._deliver()

    def _deliver(self) -> None:
        while (sample := self.waiting.pop(self.expected, None)) is not None:
            self.expected += 1
            self.reader.deliver(sample, self.writer.gid)

    # Heartbeats: who has missed what

    def beat(self) -> None:
        """Tell the reader which messages there are."""
        writer = self.writer
        if self.is_reliable and writer.is_open and writer.links.get(self.reader) is self:
            oldest = writer.history[0].number if writer.history else writer.number + 1
            newest = writer.number
            self._go(self.reader.owner, lambda: self._hear_beat(oldest, newest))
            self._beat_later()

    def _beat_later(self) -> None:
        if self.is_reliable and not self.is_beating:
            self.is_beating = True
            here().after(HEARTBEAT, lambda: self.writer.owner.do(self._beat_again))

    def _beat_again(self) -> None:
        self.is_beating = False
        if self.acknowledged < self.writer.number:
            self.beat()

    def _hear_beat(self, oldest: int, newest: int) -> None:
        if not self.reader.is_open or self.writer not in self.reader.writers:
            return
        while self.expected < oldest:  # gone for good
            sample = self.waiting.pop(self.expected, None)
            self.expected += 1
            if sample is None:
                self.reader.lost += 1
            else:
                self.reader.deliver(sample, self.writer.gid)
        self._deliver()
        base = self.expected
        missing = [each for each in range(base, newest + 1) if each not in self.waiting]
        self._go(self.writer.owner, lambda: self._hear_answer(base, missing))

    def _hear_answer(self, base: int, missing: list[int]) -> None:
        if base - 1 > self.acknowledged:
            self.acknowledged = base - 1
            self.writer.forget_acknowledged()
            self.writer.changed()
        again = [each for each in self.writer.history if each.number in missing]
        for sample in again:
            self._go(self.reader.owner, lambda sample=sample: self._arrive(sample))  # type: ignore[misc]
        if missing:
            self.beat()
