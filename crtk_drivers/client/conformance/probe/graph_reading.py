"""What the ROS graph says of a namespace."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import contextmanager
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from crtk_drivers.client.conformance.observed import Endpoint, Graph
from crtk_drivers.client.discovery import POLL, Catalogue
from crtk_drivers.client.ros_link import Link
from crtk_drivers.commands import ROS_TYPES, Direction, Payload
from crtk_drivers.ros.messages import TYPES

SETTLE = 1.0
"""Seconds without anything new after which a namespace is complete."""
LONGEST = 6.0
"""Seconds after which it is taken as it is."""


def find_device(link: Link, namespace: str, timeout: float) -> tuple[Graph, Mapping[str, Any]]:
    """Return the graph of a namespace once it is complete, and the manifest, empty without one.

    Raises:
        ConnectionFailed: nothing of CRTK is there in `timeout` s.
    """
    catalogue = Catalogue(link, namespace)
    catalogue.wait(timeout)
    hashes = _known_hashes(link.node)
    deadline = time.monotonic() + LONGEST
    graph, settled = read_graph(link.node, namespace, hashes), time.monotonic()
    while time.monotonic() < min(deadline, settled + SETTLE):
        time.sleep(POLL)
        newer = read_graph(link.node, namespace, hashes)
        if newer != graph:
            graph, settled = newer, time.monotonic()
    return graph, catalogue.manifest


def read_graph(node: Node, namespace: str, known_hashes: Mapping[str, str]) -> Graph:
    """Return the endpoints and services below a namespace, without those of `node`."""
    prefix = f"{namespace.rstrip('/')}/"
    endpoints: list[Endpoint] = []
    for topic, _ in node.get_topic_names_and_types():
        if not topic.startswith(prefix):
            continue
        name = topic.removeprefix(prefix)
        for direction, infos in (
            (Direction.PUBLISHED, node.get_publishers_info_by_topic(topic)),
            (Direction.COMMANDED, node.get_subscriptions_info_by_topic(topic)),
        ):
            found = [_endpoint(name, direction, info) for info in infos]
            endpoints += [each for each in found if each.node != node.get_fully_qualified_name()]
    services = {
        name.removeprefix(prefix): tuple(types)
        for name, types in node.get_service_names_and_types()
        if name.startswith(prefix)
    }
    ordered = sorted(endpoints, key=lambda each: (each.name, each.direction, each.node))
    return Graph(namespace, tuple(ordered), services, known_hashes)


def _endpoint(name: str, direction: Direction, info: Any) -> Endpoint:
    profile = info.qos_profile
    return Endpoint(
        name,
        direction,
        info.topic_type,
        str(info.topic_type_hash or ""),
        f"{info.node_namespace.rstrip('/')}/{info.node_name}",
        profile.reliability is not ReliabilityPolicy.BEST_EFFORT,
        profile.durability is DurabilityPolicy.TRANSIENT_LOCAL,
    )


def _known_hashes(node: Node) -> dict[str, str]:
    """Return the hashes of the state messages as they are installed here, by endpoints of our own."""
    found = {}
    for payload in (Payload.OPERATING_STATE, Payload.TEXT):
        topic = f"{node.get_fully_qualified_name()}/{payload.name.lower()}_hash"
        with _publisher(node, TYPES[payload], topic):
            for info in node.get_publishers_info_by_topic(topic):
                found[ROS_TYPES[payload]] = str(info.topic_type_hash or "")
    return found


@contextmanager
def _publisher(node: Node, kind: type, topic: str) -> Any:
    publisher = node.create_publisher(kind, topic, 1)
    try:
        yield publisher
    finally:
        node.destroy_publisher(publisher)
