"""The policy of a device names all that its nodes have on ROS: what it forgets they could not make."""

from __future__ import annotations

from collections.abc import Callable
from fnmatch import fnmatchcase
from xml.etree import ElementTree

import pytest
import rclpy
from rclpy.context import Context

from crtk_drivers import plugins
from crtk_drivers.config import NodeConfig, from_values, load
from crtk_drivers.ros.policy import interfaces, policy
from crtk_drivers.session import Session
from rigs.loopback_node import served
from rigs.waiting import eventually

SPACE = "/secured"


@pytest.mark.parametrize(
    ("name", "moveit"), [("loopback", False), ("loopback", True), ("virtual", False)]
)
def test_all_that_the_nodes_have_is_allowed_and_nothing_else(name: str, moveit: bool) -> None:
    config = NodeConfig(moveit=moveit)
    plugin = plugins.device(name)
    session = Session(plugin, load(plugin.config, from_values(plugin.typical)))
    device = session.engine.device
    (profile, *_) = ElementTree.fromstring(policy(device, SPACE, config)).iter("profile")

    def allowed(kind: str, verb: str) -> set[str]:
        rules = profile.findall(f"{kind}[@{verb}='ALLOW']")
        return {each.text or "" for rule in rules for each in rule}

    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("onlooker", context=context)
    nodes = [
        full.rpartition("/") for each in interfaces(device, SPACE, config) for full in each.nodes
    ]
    seen: dict[tuple[str, str], Callable[..., list[tuple[str, list[str]]]]] = {
        ("topics", "publish"): node.get_publisher_names_and_types_by_node,
        ("topics", "subscribe"): node.get_subscriber_names_and_types_by_node,
        ("services", "reply"): node.get_service_names_and_types_by_node,
    }

    def there(kind: str, verb: str) -> set[str]:
        return {name for space, _, own in nodes for name, _ in seen[kind, verb](own, space)}

    try:
        with served(session, SPACE, (), config):
            known = {f"{space}/{own}" for space, _, own in nodes}
            eventually(
                lambda: known <= {f"{s}/{n}" for n, s in node.get_node_names_and_namespaces()},
                "the nodes are seen",
            )
            for kind, verb in seen:
                maybe = {"/clock", "/parameter_events", "/rosout"}
                names = allowed(kind, verb)
                eventually(lambda: names - maybe <= there(kind, verb), f"all of {verb}")  # noqa: B023
                missing = {
                    name for name in there(kind, verb)
                    if not any(fnmatchcase(name, rule) for rule in names)
                }  # fmt: skip
                assert not missing
    finally:
        node.destroy_node()
        context.try_shutdown()
