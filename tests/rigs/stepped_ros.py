"""ROS 2 within one process whose time is stepped: endpoints as a node's, messages as CDR bytes, no waiting.

Who publishes calls whoever subscribes. `Steps` stand in for the module `time`, where nothing happens but in
steps of `PERIOD`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import ceil
from types import ModuleType, SimpleNamespace
from typing import Any, Final
from unittest.mock import patch

from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

from crtk_drivers.client.conformance.observed import Endpoint, Graph
from crtk_drivers.commands import Direction

PERIOD: Final = 0.01
EPOCH_NS: Final = 1_700_000_000_000_000_000


class Steps:
    """Time that passes in steps, each of which somebody may do something in."""

    def __init__(self) -> None:
        self.count = 0
        self._asked = 0
        self.step: Callable[[], None] = lambda: None
        """Called once a step."""

    def monotonic(self) -> float:
        return 1e-9 * self._told()

    def time_ns(self) -> int:
        return EPOCH_NS + self._told()

    def _told(self) -> int:
        """Return ns that nobody was told before."""
        self._asked += 1
        return round(1e9 * PERIOD) * self.count + self._asked

    def sleep(self, seconds: float) -> None:
        """Do as many steps as begin in that time."""
        for _ in range(ceil(seconds / PERIOD - 1e-6)):
            self.go_on()

    def go_on(self) -> None:
        self.count += 1
        self.step()

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Do steps until a condition holds; return whether it does."""
        for _ in range(ceil(timeout / PERIOD)):
            if condition():
                return True
            self.go_on()
        return condition()

    @contextmanager
    def instead_of_time(self, *modules: ModuleType) -> Iterator[None]:
        """Within, `time` of these modules is this."""
        kept = [patch.object(module, "time", self) for module in modules]
        for each in kept:
            each.start()
        try:
            yield
        finally:
            for each in kept:
                each.stop()


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
