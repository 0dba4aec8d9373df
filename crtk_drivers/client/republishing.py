"""Publishes what was recorded, byte for byte and in its time, in another namespace."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from crtk_drivers.client.ros_link import Link
from crtk_drivers.commands import Direction, find
from crtk_drivers.errors import ConfigError
from crtk_drivers.recording import Message
from crtk_drivers.ros import qos
from crtk_drivers.ros.plain import message_class

LONGEST_SLEEP: Final = 0.05
"""Seconds after which it is looked whether to end."""


def is_command(topic: str) -> bool:
    """Whether a topic commands a device: nothing that moves one is published again."""
    space, _, name = topic.rpartition("/")
    for candidate in (f"{space.rpartition('/')[2]}/{name}", name):
        try:
            return find(candidate).direction is Direction.COMMANDED
        except KeyError:
            continue
    return False


def common_namespace(topics: Iterable[str]) -> str:
    """Return the namespace that all topics are in; empty if they have none in common."""
    parts = [topic.split("/")[:-1] for topic in topics]
    if not parts:
        return ""
    common = []
    for names in zip(*parts, strict=False):
        if len(set(names)) > 1:
            break
        common.append(names[0])
    return "/".join(common)


class Republisher:
    """Publishers of topics. `play` belongs to one thread.

    Args:
        link: to ROS, started.
        topics: types by topic.
        latched: those of them whose newest message holds.
        namespace: in which they are published, in place of the one that they have in common.

    Attributes:
        names: on ROS, by topic as it was recorded.
        unknown: topics whose type is not installed here, and why.
    """

    def __init__(
        self, link: Link, topics: Mapping[str, str], latched: Iterable[str], namespace: str
    ) -> None:
        self.names: dict[str, str] = {}
        self.unknown: dict[str, str] = {}
        self._link = link
        self._publishers: dict[str, Any] = {}
        was, latched = common_namespace(topics), frozenset(latched)
        for topic, type_name in topics.items():
            try:
                kind = message_class(type_name)
            except (ConfigError, ValueError) as error:
                self.unknown[topic] = str(error)
                continue
            name = f"{namespace.rstrip('/')}{topic.removeprefix(was)}"
            profile = qos.LATCHED if topic in latched else qos.DATA
            self.names[topic] = name
            self._publishers[topic] = link.node.create_publisher(kind, name, profile)

    def play(
        self,
        messages: Iterable[Message],
        rate: float,
        told: Callable[[int, float], bool],
    ) -> int:
        """Publish messages, each at its time, and return how many.

        Args:
            messages: by log time.
            rate: times as fast as they were recorded.
            told: called with the number of messages and seconds so far, again and again; False ends it.
        """
        first: int | None = None
        began, count = time.monotonic(), 0
        for message in messages:
            publisher = self._publishers.get(message.topic)
            if publisher is None:
                continue
            first = message.log_time if first is None else first
            at = (message.log_time - first) * 1e-9
            while (left := began + at / rate - time.monotonic()) > 0.0:
                if not told(count, at):
                    return count
                time.sleep(min(left, LONGEST_SLEEP))
            publisher.publish(message.data)
            count += 1
            if count % 100 == 0 and not told(count, at):
                return count
        return count

    def close(self) -> None:
        """Publish no more."""
        for publisher in self._publishers.values():
            self._link.node.destroy_publisher(publisher)
        self._publishers.clear()
