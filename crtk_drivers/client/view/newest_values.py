"""The newest value of a topic, taken when somebody looks: no callback, whatever the rate of its publisher."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any, Final

import rclpy
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from crtk_drivers.client.inbox import Received, Unreadable
from crtk_drivers.recording import cdr
from crtk_drivers.samples import JointState, Value

if TYPE_CHECKING:
    from crtk_drivers.client.ros_link import Link

_numbers = count()
NEWEST: Final = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""Heard from every publisher; none waits for whoever looks."""

STALE: Final = 1.0
"""Seconds without a new value after which the last one is old."""


@dataclass(frozen=True, slots=True)
class Seen:
    """A value, its stamp (ns, 0 for what is not valid), and when it, with this stamp, was first seen (s)."""

    value: Value
    wall_ns: int
    since: float

    @property
    def is_old(self) -> bool:
        """Whether it is not what is so now."""
        return not self.wall_ns or time.monotonic() - self.since > STALE


def joints_in(seen: Mapping[str, Seen]) -> tuple[JointState, Seen] | None:
    """Return `measured_js` among values by name, and how it was seen; None if it is not there."""
    found = seen.get("measured_js")
    if found is None or not isinstance(found.value, JointState):
        return None
    return found.value, found


class Sampled:
    """A topic of which only the newest message is kept, by DDS. Made by `Sampler`; for one thread."""

    def __init__(self, subscription: Any, kind: type) -> None:
        fields: dict[str, str] = kind.get_fields_and_field_types()  # type: ignore[attr-defined]
        self.subscription = subscription
        self._kind = kind
        self._has_header = next(iter(fields.items()), None) == ("header", "std_msgs/Header")
        self._seen: Seen | None = None

    def look(self) -> Seen | None:
        """Return the newest value that can be read; None if there was none yet."""
        with self.subscription.handle:
            taken = self.subscription.handle.take_message(self._kind, True)
        if taken is not None:
            self._keep(taken[0])
        return self._seen

    def _keep(self, data: bytes) -> None:
        now = time.monotonic()
        try:
            wall_ns = cdr.stamp_of(data) if self._has_header else time.time_ns()
            value = Received(data, self._kind, wall_ns, now, 0, now).value
        except (cdr.Malformed, Unreadable):
            return  # as if it had not been sent; an Inbox of the same topic tells it
        last = self._seen
        is_same = last is not None and last.wall_ns == wall_ns
        self._seen = Seen(value, wall_ns, last.since if last is not None and is_same else now)


class Sampler:
    """A node that nobody spins, for such topics.

    Args:
        link: whose connection to ROS it uses.
    """

    def __init__(self, link: Link) -> None:
        self._node = rclpy.create_node(
            f"crtk_view_{next(_numbers)}",
            context=link.node.context,
            enable_rosout=False,
            start_parameter_services=False,
        )

    def topic(self, topic: str, kind: type) -> Sampled:
        """Return a topic by its full name and the ROS class of its messages."""
        subscription = self._node.create_subscription(kind, topic, _not_called, NEWEST, raw=True)
        return Sampled(subscription, kind)

    def leave(self, sampled: Sampled) -> None:
        """Look at a topic no more."""
        self._node.destroy_subscription(sampled.subscription)

    def close(self) -> None:
        """Leave all of them."""
        self._node.destroy_node()


def _not_called(data: bytes) -> None:
    raise AssertionError("nobody spins this node")
