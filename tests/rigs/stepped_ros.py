"""ROS 2 within one process: endpoints as a node's, real messages as CDR bytes, no waiting and no threads.

Who publishes calls whoever subscribes.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

from crtk_drivers.client.conformance.observed import Endpoint, Graph
from crtk_drivers.commands import Direction


class Wire:
    """What the nodes share: who publishes and who listens, by full topic name."""

    def __init__(self) -> None:
        self.publishers: dict[str, list[Publisher]] = {}
        self.subscriptions: dict[str, list[Subscription]] = {}


class Subscription:
    def __init__(self, node: Node, kind: type, topic: str, hear: Callable[[Any], None], qos: Any):
        self.node, self.kind, self.topic, self.hear = node, kind, topic, hear
        self.qos = qos if isinstance(qos, QoSProfile) else QoSProfile(depth=qos)


class Publisher:
    def __init__(self, node: Node, kind: type, topic: str, qos: Any):
        self.node, self.kind, self.topic = node, kind, topic
        self.qos = qos if isinstance(qos, QoSProfile) else QoSProfile(depth=qos)
        self.last = b""

    def publish(self, message: Any) -> None:
        self.last = serialize_message(message)
        for each in self._heard_by():
            each.hear(deserialize_message(self.last, self.kind))

    def get_subscription_count(self) -> int:
        return len(self._heard_by())

    def _heard_by(self) -> list[Subscription]:
        there = self.node.wire.subscriptions.get(self.topic, ())
        return [each for each in there if each.kind is self.kind and fits(self.qos, each.qos)]


def fits(offered: QoSProfile, asked: QoSProfile) -> bool:
    """Whether a publisher serves a subscription."""
    return (
        offered.reliability is not ReliabilityPolicy.BEST_EFFORT
        or asked.reliability is ReliabilityPolicy.BEST_EFFORT
    ) and (is_latched(offered) or not is_latched(asked))


def is_latched(qos: QoSProfile) -> bool:
    return qos.durability is DurabilityPolicy.TRANSIENT_LOCAL


class Node:
    """As much of `rclpy.node.Node` as the device and the tool use."""

    def __init__(self, wire: Wire, name: str, namespace: str = "") -> None:
        self.wire = wire
        self._name, self._namespace = name, namespace
        self._log = self.create_publisher(Log, "/rosout", 10)

    def get_fully_qualified_name(self) -> str:
        return f"{self._namespace}/{self._name}"

    def get_logger(self) -> Any:
        name = self.get_fully_qualified_name().strip("/").replace("/", ".")
        return SimpleNamespace(
            warning=lambda text: self._log.publish(Log(name=name, msg=text)),
        )

    def create_publisher(self, kind: type, topic: str, qos: Any) -> Publisher:
        publisher = Publisher(self, kind, self._full(topic), qos)
        self.wire.publishers.setdefault(publisher.topic, []).append(publisher)
        return publisher

    def create_subscription(
        self, kind: type, topic: str, hear: Callable[[Any], None], qos: Any
    ) -> Subscription:
        found = Subscription(self, kind, self._full(topic), hear, qos)
        self.wire.subscriptions.setdefault(found.topic, []).append(found)
        for each in self.wire.publishers.get(found.topic, ()):
            latched = is_latched(each.qos) and is_latched(found.qos)
            if latched and each.kind is kind and each.last:
                hear(deserialize_message(each.last, kind))
        return found

    def create_service(self, kind: type, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Services are asked of a device at rest, over ROS."""

    def destroy_publisher(self, publisher: Publisher) -> None:
        self.wire.publishers[publisher.topic].remove(publisher)

    def destroy_subscription(self, subscription: Subscription) -> None:
        self.wire.subscriptions[subscription.topic].remove(subscription)

    def graph(self) -> Graph:
        """Return what it has in its namespace."""
        ends = (
            (Direction.PUBLISHED, self.wire.publishers),
            (Direction.COMMANDED, self.wire.subscriptions),
        )
        return Graph(
            self._namespace,
            tuple(
                self._endpoint(direction, end)
                for direction, topics in ends
                for topic in topics.values()
                for end in topic
                if end.node is self and end.topic.startswith(f"{self._namespace}/")
            ),
        )

    def _endpoint(self, direction: Direction, end: Publisher | Subscription) -> Endpoint:
        package, _, rest = end.kind.__module__.partition(".")
        return Endpoint(
            end.topic.removeprefix(f"{self._namespace}/"),
            direction,
            f"{package}/{rest.partition('.')[0]}/{end.kind.__name__}",
            "",
            self.get_fully_qualified_name(),
            end.qos.reliability is not ReliabilityPolicy.BEST_EFFORT,
            is_latched(end.qos),
        )

    def _full(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"{self._namespace}/{topic}"
