"""Publishers, subscriptions, clients and services of rclpy, in a world, and the events of these."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Final

from typing_extensions import override

from crtk_drivers.testing.world.machine.kernel import NS, NotSimulated, here
from crtk_drivers.testing.world.middleware import rclpy_handles
from crtk_drivers.testing.world.middleware.dds import Endpoint, Quality, Reader, Taken, Writer
from crtk_drivers.testing.world.middleware.rclpy_handles import Handle, Node

_KEEP_LAST, _RELIABLE, _TRANSIENT_LOCAL, _AUTOMATIC = 1, 1, 1, 1  # rmw/types.h
_BEST_AVAILABLE: Final = {"reliability": 4, "durability": 4, "liveliness": 5}  # rmw/types.h
_POLICIES: Final = {"reliability": 1 << 4, "durability": 1 << 1}
"""Numbers of rmw_qos_policy_kind_t (rmw/qos_policy_kind.h)."""
_EVENTS: Final = ("_MATCHED", "_INCOMPATIBLE_QOS", "_INCOMPATIBLE_TYPE", "_MESSAGE_LOST")
"""Ends of the names of the events that worlds have."""
_NEVER: Final = (0, (1 << 63) - 1)
"""ns of a deadline or a lifespan that is none."""
_WAIT_FOR_CLIENT: Final = 0.1
"""s for which a response waits for its client to be found (rmw_fastrtps, rmw_response.cpp)."""


def type_name(kind: Any) -> str:
    """Return the name of a type as ROS has it."""
    package, _, rest = kind.__module__.partition(".")
    return f"{package}/{rest.partition('.')[0]}/{kind.__name__}"


def quality_of(profile: Any) -> Quality:
    """Return what a profile asks for.

    Raises:
        NotSimulated: more than worlds have.
    """
    asked = profile.to_dict()
    for policy in ("deadline", "lifespan"):
        if asked[policy].nanoseconds not in _NEVER:
            raise NotSimulated(f"the quality of service {policy}")
    if asked["history"] not in (0, _KEEP_LAST):
        raise NotSimulated("the history KEEP_ALL")
    if any(asked[policy] == number for policy, number in _BEST_AVAILABLE.items()):
        raise NotSimulated("the quality of service BEST_AVAILABLE")
    if asked["liveliness"] not in (0, _AUTOMATIC):
        raise NotSimulated("liveliness that a program asserts")
    return Quality(
        max(1, asked["depth"]),
        asked["reliability"] in (0, _RELIABLE),
        asked["durability"] == _TRANSIENT_LOCAL,
    )


class _OfEndpoint(Handle):
    """What has an endpoint of DDS."""

    endpoint: Endpoint

    def __init__(self, node: Node) -> None:
        super().__init__()
        self.node = node

    def get_logger_name(self) -> str:
        """As rclpy."""
        return self.node.logger_name()

    @override
    def destroyed(self) -> None:
        """Close the endpoint."""
        self.endpoint.close()


class _OfTopic(_OfEndpoint):
    """What has one end of a topic."""

    side: type[Endpoint]

    def __init__(self, node: Node, kind: Any, topic: str, profile: Any) -> None:
        super().__init__(node)
        self.kind = kind
        self._topic = node.full(topic)
        self.endpoint = self.side(
            node.participant,
            node.key,
            f"rt{self._topic}",
            type_name(kind),
            quality_of(profile),
            profile,
        )

    def get_topic_name(self) -> str:
        """As rclpy."""
        return self._topic


class Publisher(_OfTopic):
    """A writer."""

    side = Writer
    endpoint: Writer

    def publish(self, message: Any) -> None:
        """As rclpy."""
        self.publish_raw(rclpy_handles.compiled.rclpy_serialize(message, self.kind))

    def publish_raw(self, data: bytes) -> None:
        """As rclpy.

        Raises:
            RCLError: its context was shut down.
        """
        if not self.is_valid:
            raise rclpy_handles.compiled.RCLError(
                "Failed to publish: publisher's context is invalid"
            )
        self.endpoint.publish(bytes(data))

    @property
    def is_valid(self) -> bool:
        """Whether its context was not shut down."""
        return self.node.context.ok()

    def get_subscription_count(self) -> int:
        """As rclpy."""
        return self.endpoint.count

    def wait_for_all_acked(self, timeout: Any) -> bool:
        """As rclpy."""
        return self.is_acknowledged(timeout.nanoseconds)

    def is_acknowledged(self, timeout: int) -> bool:
        """Return whether all is acknowledged within so many ns."""
        kernel, writer = here(), self.endpoint
        end = None if timeout < 0 else kernel.now + timeout
        while not writer.is_acknowledged:
            if end is not None and kernel.now >= end:
                return False
            kernel.wait((writer.waiters,), end)
        return True


class Subscription(_OfTopic):
    """A reader."""

    side = Reader
    endpoint: Reader

    def __init__(self, node: Node, kind: Any, topic: str, profile: Any) -> None:
        super().__init__(node, kind, topic, profile)
        self.endpoint.listeners.append(self.changed)
        self.tell: Callable[[], object] | None = None

    @override
    def changed(self) -> None:
        """Tell those who wait, and whom rcl was asked to tell."""
        super().changed()
        if self.tell is not None and self.ready:
            self.tell()

    @property
    @override
    def ready(self) -> bool:
        """Whether a message has come."""
        return bool(self.endpoint.cache)

    @property
    @override
    def unread(self) -> int:
        return len(self.endpoint.cache)

    def take(self) -> Taken | None:
        """Return the oldest message, once."""
        return self.endpoint.take()

    def take_message(self, kind: Any, raw: bool) -> tuple[Any, dict[str, Any]] | None:
        """As rclpy."""
        taken = self.take()
        if taken is None:
            return None
        data = taken.sample.data
        told = {
            "source_timestamp": taken.sample.sent_ns,
            "received_timestamp": taken.received_ns,
            "publication_sequence_number": taken.sample.number,
            "reception_sequence_number": None,
        }
        return (data if raw else rclpy_handles.compiled.rclpy_deserialize(data, kind)), told

    def get_publisher_count(self) -> int:
        """As rclpy."""
        return self.endpoint.count


class _OfService(_OfEndpoint):
    """What has a reader and a writer of a service."""

    reader: Reader
    writer: Writer

    def _make(self, kind: Any, name: str, profile: Any, reads: str, writes: str) -> None:
        for each in (kind.Request, kind.Response):
            each.__class__.__import_type_support__()
        self.kind = kind
        self.full_name = self.node.full(name)
        named, quality = type_name(kind), quality_of(profile)
        ends = {"rq": "Request", "rr": "Reply"}
        kinds = {"rq": f"{named}_Request", "rr": f"{named}_Response"}

        def make(side: type, way: str) -> Any:
            topic = f"{way}{self.full_name}{ends[way]}"
            node = self.node
            return side(node.participant, node.key, topic, kinds[way], quality, profile)

        self.writer = make(Writer, writes)
        self.reader = make(Reader, reads)
        self.reader.listeners.append(self.changed)

    @property
    @override
    def ready(self) -> bool:
        """Whether a request or an answer has come."""
        return bool(self.reader.cache)

    @property
    @override
    def unread(self) -> int:
        return len(self.reader.cache)

    @override
    def destroyed(self) -> None:
        """Close both."""
        self.writer.close()
        self.reader.close()


@dataclass(frozen=True)
class RequestId:
    """In place of rclpy's ``rmw_request_id_t``.

    Attributes:
        client: its id.
        sequence_number: of its request.
    """

    client: bytes
    sequence_number: int


@dataclass(frozen=True)
class ServiceInfo:
    """What is told of a request or an answer, in place of rclpy's ``rmw_service_info_t``."""

    source_timestamp: int
    received_timestamp: int
    request_id: RequestId


def _header(taken: Taken) -> ServiceInfo:
    assert taken.sample.related is not None
    sent = taken.sample.sent_ns  # rmw_fastrtps tells of no other time
    return ServiceInfo(sent, sent, RequestId(*taken.sample.related))


class Client(_OfService):
    """Who asks a service."""

    def __init__(self, node: Node, kind: Any, name: str, profile: Any) -> None:
        super().__init__(node)
        self._make(kind, name, profile, reads="rr", writes="rq")
        self.reader.only_for = self.reader.gid
        self._asked = 0

    @property
    def service_name(self) -> str:
        """As rclpy."""
        return self.full_name

    def send_request(self, request: Any) -> int:
        """As rclpy."""
        self._asked += 1
        data = rclpy_handles.compiled.rclpy_serialize(request, self.kind.Request)
        self.writer.publish(data, (self.reader.gid, self._asked))
        return self._asked

    def service_server_is_available(self) -> bool:
        """As rclpy: both ways were found."""
        return bool(self.writer.count and self.reader.count)

    def take_response(self, kind: Any) -> tuple[Any, Any]:
        """As rclpy."""
        taken = self.reader.take()
        if taken is None:
            return None, None
        return _header(taken), rclpy_handles.compiled.rclpy_deserialize(taken.sample.data, kind)


class Service(_OfService):
    """Who answers."""

    def __init__(self, node: Node, kind: Any, name: str, profile: Any) -> None:
        super().__init__(node)
        self._make(kind, name, profile, reads="rq", writes="rr")
        self._clients: dict[bytes, None] = {}  # that were found once
        self.qos = profile

    @property
    def name(self) -> str:
        """As rclpy."""
        return self.full_name

    def take(self) -> Taken | None:
        """Return the oldest request, once."""
        return self.reader.take()

    def service_take_request(self, kind: Any) -> tuple[Any, Any]:
        """As rclpy."""
        taken = self.take()
        if taken is None:
            return None, None
        return rclpy_handles.compiled.rclpy_deserialize(taken.sample.data, kind), _header(taken)

    def service_send_response(self, response: Any, header: Any) -> None:
        """As rclpy."""
        data = rclpy_handles.compiled.rclpy_serialize(response, self.kind.Response)
        if not self.respond(data, (header.client, header.sequence_number)):
            warnings.warn(
                "failed to send response (timeout): client will not receive response",
                RuntimeWarning,
                stacklevel=1,
            )

    def respond(self, data: bytes, related: tuple[bytes, int]) -> bool:
        """Send an answer; return False if its client is not found in time. One that has gone gets none."""
        kernel, writer, client = here(), self.writer, related[0]
        end = kernel.now + int(_WAIT_FOR_CLIENT * NS)
        while not any(reader.gid == client for reader in writer.links):
            if client in self._clients:
                return True
            if kernel.now >= end:
                return False
            kernel.wait((writer.waiters,), end)
        self._clients[client] = None
        writer.publish(data, related)
        return True


class TypeDescriptionService(Handle):
    """The service ``~/get_type_description``, which is there and answers nobody."""

    def __init__(self, node: Node) -> None:
        super().__init__()
        from rclpy.qos import qos_profile_services_default
        from type_description_interfaces.srv import GetTypeDescription

        profile = qos_profile_services_default.get_c_qos_profile()
        self.impl = Service(node, GetTypeDescription, "~/get_type_description", profile)

    def handle_request(self, *_: object) -> None:
        """Refuse.

        Raises:
            NotSimulated: always.
        """
        raise NotSimulated("the service get_type_description")

    @override
    def destroyed(self) -> None:
        """End the service."""
        self.impl.destroy_when_not_in_use()


class EventHandle(Handle):
    """What a program is told of an endpoint: whom it was matched with, and whom it cannot serve."""

    def __init__(self, parent: Publisher | Subscription, kind: Any) -> None:
        super().__init__()
        self._endpoint = parent.endpoint
        self._kind = kind.name
        if not self._kind.endswith(_EVENTS):
            raise rclpy_handles.compiled.UnsupportedEventTypeError(
                f"a world has no event {self._kind}"
            )
        self._taken = self._gone = 0
        self._endpoint.listeners.append(self._look)

    def _look(self) -> None:
        if self.ready:
            self.changed()

    @property
    def _happened(self) -> int:
        if self._kind.endswith("_MATCHED"):
            return self._endpoint.found + self._endpoint.gone
        if self._kind.endswith("_INCOMPATIBLE_QOS"):
            return len(self._endpoint.refused)
        if self._kind.endswith("_MESSAGE_LOST"):
            return self._endpoint.lost if isinstance(self._endpoint, Reader) else 0
        return 0  # nobody is told that two types differ

    @property
    @override
    def ready(self) -> bool:
        """Whether something has happened since it was taken."""
        return self._happened > self._taken

    def take_event(self) -> Any:
        """As rclpy."""
        endpoint, happened = self._endpoint, self._happened
        change, self._taken = happened - self._taken, happened
        gone, self._gone = endpoint.gone - self._gone, endpoint.gone
        is_match = self._kind.endswith("_MATCHED")
        return SimpleNamespace(
            total_count=endpoint.found if is_match else happened,
            total_count_change=change - gone if is_match else change,
            current_count=endpoint.count,
            current_count_change=change - 2 * gone,
            last_policy_kind=_POLICIES[endpoint.refused[-1]] if endpoint.refused else 0,
        )

    @override
    def destroyed(self) -> None:
        """Look no more."""
        self._endpoint.listeners.remove(self._look)
