"""Records topics of devices that run, of any maker: the bytes as they come, by the publishers' own QoS."""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from typing import Any, Final

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile

from crtk_drivers.client.ros_link import Link
from crtk_drivers.commands import device_of
from crtk_drivers.errors import ConfigError
from crtk_drivers.recording import Raw, Recorder, cdr, cdr_transforms
from crtk_drivers.ros import qos
from crtk_drivers.ros.definitions import definition_of
from crtk_drivers.ros.names import AMONG_DRIVERS
from crtk_drivers.ros.plain import message_class

DEPTH: Final = 2000
"""Messages of a topic that may wait in DDS."""

STATE_SERVICE: Final = "crtk_msgs/srv/TriggerOperatingState"


class TopicRecorder:
    """Subscribes to topics, and hands their messages to a recorder. `look` belongs to one thread.

    Args:
        link: to ROS, started.
        recorder: takes the messages.
        namespaces: all topics in them are recorded, unless `topics` names some.
        topics: full names, or names in each namespace.
        beside: full names of topics that are recorded in any case: ``/tf``.

    Attributes:
        topics: that are recorded, with their types.
        drivers: recorded namespaces of drivers of ours that tell their state.
        unknown: topics whose type is not installed here, or is not one; they cannot be recorded.
        missed: messages that did not come, as far as DDS tells.
    """

    def __init__(
        self,
        link: Link,
        recorder: Recorder,
        namespaces: Sequence[str],
        topics: Sequence[str] = (),
        beside: Sequence[str] = (),
    ) -> None:
        self.topics: dict[str, str] = {}
        self.drivers: frozenset[str] = frozenset()
        self.unknown: dict[str, str] = {}
        self.missed = 0
        self._link = link
        self._recorder = recorder
        self._prefixes = tuple(f"{namespace.rstrip('/')}/" for namespace in namespaces)
        self._wanted = frozenset(_full(topics, self._prefixes))
        self._beside = frozenset(beside)
        self._subscriptions: list[Any] = []

    def look(self) -> None:
        """Subscribe to the topics that have appeared."""
        there = self._link.topics()
        for topic, types in there.items():
            if topic in self.topics or topic in self.unknown or not self._is_wanted(topic):
                continue
            infos = self._link.node.get_publishers_info_by_topic(topic)
            if infos:
                self._subscribe(topic, types, [info.qos_profile for info in infos])
        services = self._link.services()
        devices = {device_of(topic) for topic in self.topics}
        self.drivers = frozenset(each for each in devices if _is_ours(each, there, services))

    def close(self) -> None:
        """Subscribe to nothing more; what has come is with the recorder."""
        for subscription in self._subscriptions:
            self._link.node.destroy_subscription(subscription)
        self._subscriptions.clear()

    @property
    def has_devices(self) -> bool:
        """Whether there is more than what is recorded beside."""
        return not self.topics.keys() <= self._beside

    def _is_wanted(self, topic: str) -> bool:
        if topic in self._beside:
            return True
        return topic in self._wanted if self._wanted else topic.startswith(self._prefixes)

    def _subscribe(self, topic: str, types: Sequence[str], offered: Sequence[QoSProfile]) -> None:
        if len(types) != 1:
            self.unknown[topic] = f"has several types: {', '.join(types)}"
            return
        (type_name,) = types
        try:
            kind = message_class(type_name)
        except ConfigError as error:
            self.unknown[topic] = error.message
            return
        profile = qos.as_offered(offered, DEPTH)
        is_latched = profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
        receive = self._receiver(topic, type_name, is_latched)
        self.topics[topic] = type_name
        events = SubscriptionEventCallbacks(message_lost=self._lost, use_default_callbacks=False)
        self._subscriptions.append(
            self._link.node.create_subscription(
                kind, topic, receive, profile, raw=True, event_callbacks=events
            )
        )

    def _lost(self, event: Any) -> None:
        self.missed += event.total_count_change

    def _receiver(self, topic: str, type_name: str, is_latched: bool) -> Callable[[bytes], None]:
        definition, put = definition_of(type_name), self._recorder.put
        has_header = definition.startswith("std_msgs/Header header\n")

        def receive(data: bytes) -> None:
            entry = (_made, topic, time.time_ns(), type_name, data, has_header, is_latched)
            put((*entry, definition), 1, len(data))

        return receive


def _made(
    topic: str,
    log_time: int,
    type_name: str,
    data: bytes,
    has_header: bool,
    is_latched: bool,
    definition: str,
) -> tuple[Raw]:
    stamp_ns = cdr.stamp_of(data) if has_header else 0
    about = _frames(data) if is_latched and type_name == cdr_transforms.TYPE else frozenset()
    made = Raw(
        topic, type_name, data, log_time, stamp_ns or log_time, is_latched, definition, about
    )
    return (made,)


def _frames(data: bytes) -> frozenset[str]:
    """Return the frames whose place a message tells; none if it cannot be read."""
    try:
        return frozenset(each.child for each in cdr_transforms.decode_transforms(data))
    except cdr.Malformed:
        return frozenset()


def _is_ours(namespace: str, topics: Container[str], services: Mapping[str, Sequence[str]]) -> bool:
    """Whether a driver of ours tells its state there.

    Of others it is not known by which clock, and of when, they stamp what they answer.
    """
    prefix = namespace.rstrip("/")
    types = services.get(f"{prefix}/operating_state", ())
    return f"{prefix}/{AMONG_DRIVERS}" in topics and STATE_SERVICE in types


def _full(topics: Sequence[str], prefixes: Sequence[str]) -> Iterable[str]:
    for topic in topics:
        if topic.startswith("/"):
            yield topic
        else:
            yield from (f"{prefix}{topic}" for prefix in prefixes)
