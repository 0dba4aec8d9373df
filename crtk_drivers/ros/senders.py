"""Who sent a message: commands that come with their sender, as far as DDS tells it.

rclpy drops the sender of a message. These subscriptions are therefore read by rcl's own function, called by
ctypes, which gives it: the id (gid) of the publisher. All publishers of a process have the first twelve bytes
of it in common with Fast DDS, and the graph says which node a publisher belongs to: a client is a node of a
process. Of other middlewares only the ids are compared, so that two publishers of one topic are two clients.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.utilities import get_rmw_implementation_identifier
from rclpy.waitable import NumberOfEntities, Waitable
from typing_extensions import override

from crtk_drivers.motion.arbiter import Client
from crtk_drivers.ros.unlocked import UnlockedNode, new_message, rcl_error

logger = logging.getLogger(__name__)

LOOK_RATE = 4.0
"""Hz at which the graph is asked whether those who let go of a device are there."""

KNOWN_SENDERS = 256
"""Publishers that are remembered at most: of one that comes back after that, the name is asked for again."""

_PARTICIPANT = 12
UNKNOWN_NAME = "_NODE_NAME_UNKNOWN_"
_NOTHING_THERE = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED (rcl/types.h)


class _MessageInfo(ctypes.Structure):
    """``rmw_message_info_t`` (rmw/types.h)."""

    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("implementation", ctypes.c_void_p),
        ("gid", ctypes.c_uint8 * 16),
        ("from_intra_process", ctypes.c_bool),
    )


# It is in this process already: rclpy is linked with it.
_take = ctypes.CDLL("librcl.so").rcl_take_serialized_message
_take.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


class Sender(Client):
    """A publisher. Two of one node in one process are the same client.

    Attributes:
        topic: full name.
        gid: of the publisher.
        participant: the part of `gid` that all publishers of its process have; empty if there is none.
        is_watched: somebody wants to know whether it is there.
    """

    def __init__(self, node: Node, topic: str, gid: bytes, has_participant: bool) -> None:
        super().__init__("")
        self._node = node
        self.topic = topic
        self.gid = gid
        self.participant = gid[:_PARTICIPANT] if has_participant else b""
        self._owner = ""
        self.is_watched = False

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
            info = self._info
            if info is not None and info.node_name != UNKNOWN_NAME:
                self._owner = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
        return self._owner

    @property
    def _info(self) -> Any:
        for info in self._node.get_publishers_info_by_topic(self.topic):
            if bytes(info.endpoint_gid)[: len(self.gid)] == self.gid:
                return info
        return None


class Senders:
    """The publishers that a node has heard."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._has_participant = get_rmw_implementation_identifier().startswith("rmw_fastrtps")
        self._known: dict[tuple[str, bytes], Sender] = {}

    def of(self, topic: str, gid: bytes) -> Sender:
        """Return the sender of a message on a topic (full name)."""
        key = topic, gid
        if key not in self._known:
            if len(self._known) >= KNOWN_SENDERS:
                self._forget_one()
            self._known[key] = Sender(self._node, topic, gid, self._has_participant)
        return self._known[key]

    def _forget_one(self) -> None:
        for key, sender in self._known.items():
            if not sender.is_watched:
                del self._known[key]
                return

    def look(self) -> None:
        """Find out which of those that are watched are there, and forget those that are not."""
        for key, sender in tuple(self._known.items()):
            if sender.is_watched:
                sender.look()
                if not sender.is_there:
                    self._known.pop(key, None)


class AttributedSubscription(Waitable):  # type: ignore[misc]  # rclpy has no types
    """Reads a subscription in the executor's stead, and hands over each message, as bytes, with its sender.

    Args:
        node: that the subscription was made by, before an executor has it.
        subscription: not used otherwise from now on.
        receive: called with the message and its sender, by the executor's thread; must not raise.
        senders: of the node.
    """

    def __init__(
        self,
        node: UnlockedNode,
        subscription: Subscription,
        receive: Callable[[bytes, Sender], None],
        senders: Senders,
    ) -> None:
        super().__init__(subscription.callback_group)
        self._handle = subscription.handle
        self._topic = subscription.topic_name
        self._receive = receive
        self._senders = senders
        self._index = -1
        self._failed = False
        self._info = _MessageInfo()
        self._message = new_message()
        node.read_by(subscription, self)

    def __del__(self) -> None:
        self._message.release()

    def __enter__(self) -> None:
        self._handle.__enter__()

    def __exit__(self, *error: object) -> None:
        self._handle.__exit__(*error)

    def get_num_entities(self) -> NumberOfEntities:
        """See rclpy."""
        return NumberOfEntities(num_subs=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        """See rclpy."""
        self._index = wait_set.add_subscription(self._handle)

    def is_ready(self, wait_set: Any) -> bool:
        """See rclpy."""
        return bool(wait_set.is_ready("subscription", self._index))

    def take_data(self) -> None:
        """Hand over the next message, unless a newer one has taken its place.

        Not in `execute`, as rclpy would: the EventsExecutor calls that only after all that has arrived by
        now, and commands of a flood would be carried out long after they were sent.
        """
        try:
            taken = self._taken()
        except Exception:
            # What anybody can send must not end the executor.
            if not self._failed:
                logger.exception("a message on %s could not be read", self._topic)
            self._failed = True
            return
        if taken is not None:
            self._receive(*taken)

    async def execute(self, nothing: None) -> None:
        """See rclpy. `take_data` has done it."""

    def _taken(self) -> tuple[bytes, Sender] | None:
        info, wire = self._info, self._message
        with self._handle:
            failed = _take(self._handle.pointer, ctypes.byref(wire), ctypes.byref(info), None)
        if failed:
            text = rcl_error()
            if failed == _NOTHING_THERE:
                return None
            raise RuntimeError(f"DDS did not hand over a message: {text}")
        data = ctypes.string_at(wire.buffer, wire.length)
        return data, self._senders.of(self._topic, bytes(info.gid))
