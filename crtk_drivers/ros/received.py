"""Messages with their sender and the time at which they came.

rclpy drops the sender of a message. It is therefore taken by rcl's own function, called by ctypes, which
gives it: the id (gid) of the publisher. This also lets go of Python's lock.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from rclpy.subscription import Subscription
from rclpy.waitable import NumberOfEntities, Waitable

from crtk_drivers.ros.arrival import Arrival
from crtk_drivers.ros.senders import Sender, Senders
from crtk_drivers.ros.unlocked import UnlockedNode, new_message, rcl_error

logger = logging.getLogger(__name__)

_NOTHING_THERE: Final = 401  # RCL_RET_SUBSCRIPTION_TAKE_FAILED (rcl/types.h)
_MOST_UNREADABLE: Final = 100
"""Messages one after the other that cannot be read, before the reader gives up until the next one comes."""
_NOT_COUNTED: Final = 2**64 - 1  # RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED (rmw/types.h)


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


class Received(NamedTuple):
    """A message.

    Attributes:
        data: as CDR.
        sender: its publisher.
        arrival: when it came, and was sent.
        lost: how many of its sender came before it, since the last one that was read, and were not read.
    """

    data: bytes
    sender: Sender
    arrival: Arrival
    lost: int = 0

    @property
    def ordered(self) -> Arrival:
        """The arrival, in order with those stops and changes of state of its process that are carried out."""
        return self.sender.clock.in_order(self.arrival)


class Messages:
    """What DDS holds of a subscription. One thread at a time.

    Args:
        subscription: not read otherwise.
        senders: of its node.
    """

    def __init__(self, subscription: Subscription, senders: Senders) -> None:
        self._handle = subscription.handle
        self._topic = subscription.topic_name
        self._senders = senders
        self._failed = False
        self._info = _MessageInfo()
        self._message = new_message()

    def __del__(self) -> None:
        self._message.release()

    def take(self) -> Received | None:
        """Return the next message; None if there is none. What cannot be read is logged and passed over."""
        for _ in range(_MOST_UNREADABLE):
            try:
                return self._taken()
            except Exception:
                # What anybody can send must not end the thread, nor hide a stop behind it.
                if not self._failed:
                    logger.exception("a message on %s could not be read", self._topic)
                self._failed = True
        return None

    def _taken(self) -> Received | None:
        info, wire = self._info, self._message
        with self._handle:
            failed = _take(self._handle.pointer, ctypes.byref(wire), ctypes.byref(info), None)
        if failed:
            text = rcl_error()
            if failed == _NOTHING_THERE:
                return None
            raise RuntimeError(f"DDS did not hand over a message: {text}")
        data = ctypes.string_at(wire.buffer, wire.length)
        sender = self._senders.of(self._topic, bytes(info.gid))
        before, number = sender.sent, info.publication_sequence_number
        sender.sent = before + 1 if number == _NOT_COUNTED else number
        lost = max(0, sender.sent - before - 1) if before else 0
        return Received(
            data, sender, sender.came(info.received_timestamp, info.source_timestamp), lost
        )


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
        self._messages = Messages(subscription, senders)
        self._receive = receive
        self._index = -1
        node.read_by(subscription, self)

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
        taken = self._messages.take()
        if taken is not None:
            self._receive(taken.data, taken.sender)

    async def execute(self, nothing: None) -> None:
        """See rclpy. `take_data` has done it."""
