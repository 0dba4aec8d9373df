"""Who sent a message, as far as DDS tells it, and how many it sends a second.

A message comes with the id (gid) of its publisher; see `crtk_drivers.ros.received`. All publishers of
a process have the first twelve bytes of it in common with Fast DDS, and the graph says which node a publisher
belongs to: a client is a node of a process. Of other middlewares only the ids are compared, so that two
publishers of one topic are two clients.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier
from typing_extensions import override

from crtk_drivers.motion.arbiter import Client
from crtk_drivers.ros.arrival import Arrival, SenderClock, as_it_came

logger = logging.getLogger(__name__)

LOOK_RATE = 4.0
"""Hz at which the graph is asked whether those who let go of a device are there."""

KNOWN_SENDERS = 4096
"""Publishers that are remembered at most: of one that comes back after that, the name is asked for again."""

ASK_PERIOD = 0.02
"""Seconds between two questions to the graph who publishes a topic: where 250 do, it takes milliseconds."""

_PARTICIPANT = 12
UNKNOWN_NAME = "_NODE_NAME_UNKNOWN_"
FLOOD_RATE = 2500.0
"""Messages a second of one publisher that are worth a warning: no device carries out as many."""


@dataclass(frozen=True, slots=True)
class Flood:
    """What one publisher sends of one topic, too often.

    Attributes:
        topic: full name.
        sender: in words.
        rate: messages a second.
    """

    topic: str
    sender: str
    rate: float

    @override
    def __str__(self) -> str:
        return f"{self.sender} sends {self.rate:.0f} messages a second on {self.topic}"


class Sender(Client):
    """A publisher. Two of one node in one process are the same client.

    Attributes:
        topic: full name.
        gid: of the publisher.
        participant: the part of `gid` that all publishers of its process have; empty if there is none.
        is_watched: somebody wants to know whether it is there.
        sent: the number of its newest message that was read here; those count that were not read, too.
        clock: of its process.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        gid: bytes,
        has_participant: bool,
        owners: Owners,
        clock: SenderClock,
    ) -> None:
        super().__init__("")
        self.clock = clock
        self._node = node
        self._owners = owners
        self.topic = topic
        self.gid = gid
        self.participant = gid[:_PARTICIPANT] if has_participant else b""
        self._owner = ""
        self.is_watched = False
        self.sent = 0
        self._sent_ns = 0
        self._counted = 0

    @property
    @override
    def name(self) -> str:
        return f"the node {self.node_name}" if self.node_name else "a node that is gone"

    @property
    @override
    def is_there(self) -> bool:
        """As `Senders.look` found it last, which looks for it from now on."""
        self.is_watched = True
        return self._is_there

    def look(self) -> None:
        """Ask the graph whether the publisher is there."""
        self._is_there = self._info is not None

    def came(self, received_ns: int, sent_ns: int) -> Arrival:
        """Return the arrival of its next message; see `SenderClock.arrival`.

        Where nothing tells which process sends, a message counts from when it comes.
        """
        if not self.participant:
            return as_it_came(received_ns, sent_ns)
        arrival = self.clock.arrival(received_ns, sent_ns, self._sent_ns)
        self._sent_ns = sent_ns
        return arrival

    def count(self) -> int:
        """Return how many messages it has sent since this was asked last."""
        sent, before = self.sent, self._counted
        self._counted = sent
        return sent - before if before else 0

    @override
    def is_same(self, other: Client) -> bool:
        if not isinstance(other, Sender):
            return False
        if self.gid == other.gid:
            return True
        if self.participant != other.participant:
            return False
        if not self.participant:
            return self.topic != other.topic  # nothing says that they are two
        mine, others = self.node_name, other.node_name
        return mine == others or "" in (mine, others)

    @property
    def node_name(self) -> str:
        """The full name, empty as long as the graph does not know it."""
        if not self._owner:
            self._owner = self._owners.of(self.topic, self.gid)
        return self._owner

    @property
    def _info(self) -> Any:
        for info in self._node.get_publishers_info_by_topic(self.topic):
            if bytes(info.endpoint_gid)[: len(self.gid)] == self.gid:
                return info
        return None


class Owners:
    """The nodes of publishers, as the graph knows them. Thread-safe.

    One question tells of all publishers of a topic. A question for each would take so long, where hundreds
    publish, that DDS lost increments meanwhile.

    Args:
        node: that asks.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._names: dict[str, dict[bytes, str]] = {}
        self._asked: dict[str, float] = {}

    def of(self, topic: str, gid: bytes) -> str:
        """Return the full name of a publisher's node, empty as long as the graph does not know it."""
        found = self._names.get(topic, {}).get(gid, "")
        now = time.monotonic()
        if found or now - self._asked.get(topic, -math.inf) < ASK_PERIOD:
            return found
        self._asked[topic] = now
        names: dict[bytes, str] = {}
        for info in self._node.get_publishers_info_by_topic(topic):
            if info.node_name != UNKNOWN_NAME:
                node_name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                names[bytes(info.endpoint_gid)[: len(gid)]] = node_name
        self._names[topic] = names
        return names.get(gid, "")


class Senders:
    """The publishers that a node has heard.

    Attributes:
        floods: what was sent too often, as `look` found it last.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._has_participant = get_rmw_implementation_identifier().startswith("rmw_fastrtps")
        self._owners = Owners(node)
        self._known: dict[tuple[str, bytes], Sender] = {}
        self._clocks: WeakValueDictionary[bytes, SenderClock] = WeakValueDictionary()
        self._lock = threading.Lock()
        self._looked = time.monotonic()
        self.floods: tuple[Flood, ...] = ()

    def of(self, topic: str, gid: bytes) -> Sender:
        """Return the sender of a message on a topic (full name)."""
        key = topic, gid
        found = self._known.get(key)
        if found is not None:
            return found
        with self._lock:
            if len(self._known) >= KNOWN_SENDERS:
                self._forget_one()
            process = gid[:_PARTICIPANT] if self._has_participant else gid
            clock = self._clocks.setdefault(process, SenderClock())
            return self._known.setdefault(
                key, Sender(self._node, topic, gid, self._has_participant, self._owners, clock)
            )

    def _forget_one(self) -> None:
        for key, sender in self._known.items():
            if not sender.is_watched:
                del self._known[key]
                return

    def look(self) -> None:
        """Find out which of those that are watched are there, forget those that are not, and count."""
        with self._lock:
            known = tuple(self._known.items())
        for key, sender in known:
            if sender.is_watched:
                sender.look()
                if not sender.is_there:
                    with self._lock:
                        self._known.pop(key, None)
        self._look_for_floods([sender for _, sender in known])

    def _look_for_floods(self, known: list[Sender]) -> None:
        now = time.monotonic()
        elapsed, self._looked = now - self._looked, now
        counted = [(sender, sender.count() / elapsed) for sender in known]
        before = {(flood.topic, flood.sender) for flood in self.floods}
        self.floods = tuple(
            Flood(sender.topic, sender.name, rate) for sender, rate in counted if rate > FLOOD_RATE
        )
        for flood in self.floods:
            if (flood.topic, flood.sender) not in before:
                logger.warning("%s, which is a flood: send less", flood)
