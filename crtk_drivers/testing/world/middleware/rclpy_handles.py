"""The classes of rclpy's compiled module that reach the middleware, in a world: contexts, nodes, endpoints.

rclpy itself, written in Python, stands on them unchanged. What needs no middleware (serialisation, the
validation of names, profiles) stays the compiled module's own.
"""

from __future__ import annotations

import itertools
import logging
import os
from typing import Any, Final, Self
from weakref import WeakValueDictionary

from typing_extensions import override

from crtk_drivers.testing.world.machine.kernel import Waiters, here
from crtk_drivers.testing.world.middleware.dds import Endpoint, Reader, Writer
from crtk_drivers.testing.world.middleware.participants import Participant, domain
from crtk_drivers.testing.world.middleware.ros_arguments import RosArguments

DOMAIN: Final = "ROS_DOMAIN_ID"
UNKNOWN: Final = ("_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_")
"""Name and namespace of the node of an endpoint, until they are known (rmw_fastrtps)."""

logger = logging.getLogger(__name__)

compiled: Any = None
"""rclpy's own module, once it is loaded."""

_numbers = itertools.count(0x5000)
_handles: WeakValueDictionary[int, Any] = WeakValueDictionary()


def handle_of(pointer: int) -> Any:
    """Return what has a ``pointer``."""
    return _handles[pointer]


class Handle:
    """What rclpy keeps of something in rcl. It is destroyed when nobody is within it any more.

    Attributes:
        pointer: a number that stands for it.
        waiters: tasks that wait until it is ready.
        listeners: called when it may have become ready, in no task.
    """

    def __init__(self) -> None:
        self.pointer = next(_numbers)
        self.waiters: Waiters = {}
        self.listeners: list[Any] = []
        self._users = 0
        self._is_unwanted = False
        _handles[self.pointer] = self

    @property
    def ready(self) -> bool:
        """Whether there is something to take."""
        return False

    @property
    def unread(self) -> int:
        """How often something is to be taken."""
        return int(self.ready)

    def __enter__(self) -> Self:
        if self._is_unwanted:
            raise compiled.InvalidHandle("cannot use Destroyable because destruction was requested")
        self._users += 1
        return self

    def __exit__(self, *_: object) -> None:
        self._users -= 1
        self._destroy_if_unused()

    def destroy_when_not_in_use(self) -> None:
        """Destroy it as soon as nobody is within it."""
        if not self._is_unwanted:
            self._is_unwanted = True
            self._destroy_if_unused()

    def _destroy_if_unused(self) -> None:
        if self._is_unwanted and not self._users:
            self._users = -1  # once
            self.destroyed()

    def destroyed(self) -> None:
        """Do what its end needs."""

    def changed(self) -> None:
        """Tell those who wait."""
        here().wake(self.waiters)
        for listener in tuple(self.listeners):
            listener()


class Context(Handle):
    """A participant, with the rules of its command line."""

    def __init__(self, arguments: list[str], domain_id: int) -> None:
        super().__init__()
        self.arguments = RosArguments()
        self.arguments.read(arguments)
        if domain_id == compiled.RCL_DEFAULT_DOMAIN_ID:
            domain_id = int(os.environ.get(DOMAIN) or 0)
        self._domain = domain_id
        self._is_valid = True
        self.participant = Participant(domain(domain_id), here().process)

    def ok(self) -> bool:
        """Whether it was not shut down."""
        return self._is_valid

    def get_domain_id(self) -> int:
        """As rclpy."""
        return self._domain

    def shutdown(self) -> None:
        """Leave the domain."""
        if not self._is_valid:
            raise compiled.RCLError("failed to shutdown: rcl_shutdown already called")
        self._is_valid = False
        self.participant.close()


class Node(Handle):
    """A name, and rules for names."""

    def __init__(
        self,
        name: str,
        namespace: str,
        context: Context,
        arguments: list[str] | None,
        use_global: bool,
        _rosout: bool,
    ) -> None:
        super().__init__()
        self.context = context
        self.participant = context.participant
        self.rules = RosArguments()
        if use_global:
            given = context.arguments
            self.rules = RosArguments(
                dict(given.renamed), given.name, given.namespace, dict(given.parameters)
            )
        self.rules.read(["--ros-args", *(arguments or ())])
        self.name = self.rules.name or name
        namespace = self.rules.namespace or namespace
        self.namespace = namespace if namespace.startswith("/") else f"/{namespace}"
        if compiled.rclpy_get_validation_error_for_node_name(self.name):
            raise ValueError(f"node name is invalid: {self.name}")
        if compiled.rclpy_get_validation_error_for_namespace(self.namespace):
            raise ValueError(f"namespace is invalid: {self.namespace}")
        self.participant.add_node(self.key)

    @property
    def key(self) -> tuple[str, str]:
        """Name and namespace."""
        return self.name, self.namespace

    @override
    def destroyed(self) -> None:
        """Take its name out of the graph."""
        self.participant.remove_node(self.key)

    def get_node_name(self) -> str:
        """As rclpy."""
        return self.name

    def get_namespace(self) -> str:
        """As rclpy."""
        return self.namespace

    def get_fully_qualified_name(self) -> str:
        """As rclpy."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    def logger_name(self) -> str:
        """As rclpy."""
        return self.get_fully_qualified_name().strip("/").replace("/", ".")

    def get_parameters(self, kind: Any) -> dict[str, Any]:
        """As rclpy."""
        return {name: kind(name, value=value) for name, value in self.rules.parameters.items()}

    def full(self, name: str, *, is_remapped: bool = True) -> str:
        """Return the full name of a topic or a service."""
        found: str = compiled.rclpy_expand_topic_name(name, self.name, self.namespace)
        return self.remapped(found) if is_remapped else found

    def remapped(self, full: str) -> str:
        """Return the name that the command line gives to a topic or a service."""
        for before, after in self.rules.renamed.items():
            if compiled.rclpy_expand_topic_name(before, self.name, self.namespace) == full:
                found: str = compiled.rclpy_expand_topic_name(after, self.name, self.namespace)
                return found
        return full

    # The graph

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        """As rclpy."""
        return [node for _, node in self.participant.known_nodes]

    def get_count_publishers(self, topic: str) -> int:
        """As rclpy."""
        return self._count("rt", topic, Writer)

    def get_count_subscribers(self, topic: str) -> int:
        """As rclpy."""
        return self._count("rt", topic, Reader)

    def get_count_clients(self, service: str) -> int:
        """As rclpy."""
        return self._count("rq", f"{service}Request", Writer)

    def get_count_services(self, service: str) -> int:
        """As rclpy."""
        return self._count("rq", f"{service}Request", Reader)

    def _count(self, prefix: str, name: str, side: type) -> int:
        return len(self.known(f"{prefix}{self.remapped(name)}", side))

    def known(self, topic: str, side: type) -> dict[Endpoint, tuple[str, str]]:
        """Return the endpoints of a topic that were found, with their nodes."""
        return {
            each: node or UNKNOWN
            for each, node in self.participant.known.items()
            if each.topic == topic and isinstance(each, side)
        }


def names_and_types(
    node: Node, prefix: str, side: type = Endpoint, of: tuple[str, str] | None = None
) -> list[tuple[str, list[str]]]:
    """Return names with their types, of what was found.

    Args:
        node: that asks.
        prefix: ``rt``: topics; ``rq``: services.
        side: `Reader` or `Writer`: only of these.
        of: only of this node.
    """
    found: dict[str, set[str]] = {}
    for each, name in node.participant.known.items():
        if each.topic.startswith(f"{prefix}/") and isinstance(each, side) and of in (None, name):
            ros = each.topic.removeprefix(prefix)
            kind = each.kind
            if prefix == "rq":
                ros, kind = ros.removesuffix("Request"), kind.removesuffix("_Request")
            found.setdefault(ros, set()).add(kind)
    return [(name, sorted(found[name])) for name in sorted(found)]


def infos(node: Node, topic: str, side: type[Endpoint]) -> list[dict[str, Any]]:
    """Return what the graph tells of the endpoints of a topic."""
    kinds = {Writer: 1, Reader: 2}  # rmw/topic_endpoint_info.h
    return [
        {
            "node_name": name,
            "node_namespace": namespace,
            "topic_type": each.kind,
            "topic_type_hash": {"version": -1, "value": bytes(32)},
            "endpoint_type": kinds[side],
            "endpoint_gid": list(each.gid),
            "qos_profile": each.details.to_dict(),
        }
        for each, (name, namespace) in node.known(f"rt{topic}", side).items()
    ]


def log(severity: int, name: str, text: str, *_: object) -> None:
    """Log what a node says, as Python does."""
    logging.getLogger(name).log(int(severity), "%s", text)
