"""The ROS abstraction layer of the official CRTK client, for scripts that were written for it.

Names, arguments and results are those that the CRTK documentation describes ("Client Libraries: Python",
RAL); of ROS 1 nothing is left but the idea. What waits has a timeout.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import Joy

from crtk_drivers.client.ros_link import GRAPH_PERIOD, Caller, Link
from crtk_drivers.ros.spinning import SPIN_PERIOD, make_executor, spin

__all__ = ["Joy", "Ral", "Rate"]

logger = logging.getLogger(__name__)


class Rate:
    """Sleeps so that a loop runs at a rate; what was late is not made up for."""

    def __init__(self, rate_hz: float) -> None:
        self._period = 1.0 / rate_hz
        self._next = time.monotonic() + self._period

    def sleep(self) -> None:
        """Wait for the end of this period."""
        now = time.monotonic()
        if now < self._next:
            time.sleep(self._next - now)
            self._next += self._period
        else:
            self._next = now + self._period


class _Shared:
    """What a layer and its children have in common: the node, its thread, and the way out."""

    def __init__(self, node_name: str, node: Node | None) -> None:
        self._owns_node = node is None
        if node is None:
            if not rclpy.ok():
                rclpy.init()
            node = rclpy.create_node(node_name)
        self.node = node
        self.link = Link(node=node)
        self.callbacks: list[Callable[[], None]] = []
        self.stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def spin(self) -> None:
        """Start the thread, if the node is ours to spin."""
        if self._thread is None and self._owns_node:
            self._thread = threading.Thread(target=self._spin, name="crtk ral", daemon=True)
            self._thread.start()

    def _spin(self) -> None:
        executor = make_executor(self.node.context)
        executor.add_node(self.node)
        try:
            spin(executor, self.stopped)
        finally:
            executor.remove_node(self.node)
            executor.shutdown(timeout_sec=SPIN_PERIOD)

    def shutdown(self) -> None:
        """Stop the thread and leave ROS. May be called twice."""
        if self.stopped.is_set():
            return
        self.stopped.set()
        for callback in self.callbacks:
            callback()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(10.0 * SPIN_PERIOD)
        self.link.close()
        if self._owns_node:
            self.node.destroy_node()
            rclpy.try_shutdown()


class Ral:
    """A node, its namespace, and what was made with it.

    Args:
        node_name: of the node that is made.
        namespace: of the topics, for example ``left``.
        node: your own, which you spin; nothing is made then.
        parent: by `create_child`.
    """

    def __init__(
        self,
        node_name: str,
        namespace: str = "",
        node: Node | None = None,
        parent: Ral | None = None,
    ) -> None:
        self._node_name = node_name
        self._namespace = namespace.strip("/")
        self.shared: _Shared = _Shared(node_name, node) if parent is None else parent.shared
        self._node = self.shared.node
        self.link = self.shared.link
        self._children: list[Ral] = []
        self._endpoints: list[Any] = []

    @staticmethod
    def ros_version() -> int:
        """Return 2."""
        return 2

    @staticmethod
    def parse_argv(argv: Sequence[str]) -> list[str]:
        """Start ROS with its share of the command line, and return the rest."""
        rclpy.init(args=list(argv))
        return list(remove_ros_args(args=list(argv)))

    def node_name(self) -> str:
        """Return the name of the node."""
        return self._node_name

    def namespace(self) -> str:
        """Return the namespace, without a leading slash."""
        return self._namespace

    def create_child(self, child_namespace: str) -> Ral:
        """Return a layer for a sub-namespace, with the same node; a further one if there is one already."""
        namespace = f"{self._namespace}/{child_namespace.strip('/')}"
        child = type(self)(self._node_name, namespace, parent=self)
        self._children.append(child)
        return child

    # ------------------------------------------------------------------------------------- spinning

    def spin(self) -> None:
        """Let messages arrive from now on, in a thread of its own."""
        self.shared.spin()

    def spin_and_execute(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Spin, call `function` with `arguments`, and shut down; Ctrl-C ends it."""
        self.spin()
        try:
            function(*arguments)
        except KeyboardInterrupt:
            pass
        finally:
            self.shutdown()

    def shutdown(self) -> None:
        """Stop spinning and leave ROS. May be called twice."""
        self.shared.shutdown()

    def on_shutdown(self, callback: Callable[[], None]) -> None:
        """Call `callback` at the beginning of `shutdown`."""
        self.shared.callbacks.append(callback)

    def is_shutdown(self) -> bool:
        """Whether ROS is left, by `shutdown` or by a signal."""
        return self.shared.stopped.is_set() or not self._node.context.ok()

    # ----------------------------------------------------------------------------------------- time

    def now(self) -> Time:
        """Return the node's time."""
        return self._node.get_clock().now()

    def get_timestamp(self, t: Any) -> Any:
        """Return the time of a message, header or stamp; a time as it is."""
        t = getattr(t, "header", t)
        t = getattr(t, "stamp", t)
        return Time.from_msg(t) if hasattr(t, "nanosec") else t

    def to_sec(self, t: Any) -> float:
        """Return the seconds of a message, time or duration."""
        t = self.get_timestamp(t)
        return float(t.nanoseconds) / 1e9 if hasattr(t, "nanoseconds") else float(t)

    def create_duration(self, d: float) -> Duration:
        """Return a duration of `d` seconds."""
        return Duration(seconds=d)

    def create_rate(self, rate_hz: float) -> Rate:
        """Return what sleeps in a loop of `rate_hz`."""
        return Rate(rate_hz)

    def create_time(self) -> Time:
        """Return time 0 of the node's clock."""
        return Time(clock_type=self._node.get_clock().clock_type)

    # ------------------------------------------------------------------------------------ endpoints

    def add_namespace(self, name: str) -> str:
        """Return the full name of a topic or service in this namespace."""
        return str(self._node.resolve_topic_name(f"{self._namespace}/{name.strip('/')}"))

    def track(self, endpoint: Any) -> Any:
        """Let `check_connections` look after an endpoint."""
        self._endpoints.append(endpoint)
        return endpoint

    def publisher(
        self, topic: str, msg_type: type, queue_size: int = 10, latch: bool = False, **options: Any
    ) -> Any:
        """Return a publisher; with `latch` what it sent is told to those who come later."""
        name, profile = self.add_namespace(topic), _profile(queue_size, latch)
        return self.track(self._node.create_publisher(msg_type, name, profile, **options))

    def subscriber(
        self,
        topic: str,
        msg_type: type,
        callback: Callable[[Any], None],
        queue_size: int = 10,
        latch: bool = False,
        **options: Any,
    ) -> Any:
        """Return a subscription; with `latch` it asks for what was said before."""
        name, profile = self.add_namespace(topic), _profile(queue_size, latch)
        return self.track(
            self._node.create_subscription(msg_type, name, callback, profile, **options)
        )

    def service_client(self, name: str, srv_type: type) -> Any:
        """Return a client of a service."""
        return self.track(self._node.create_client(srv_type, self.add_namespace(name)))

    def get_topic_name(self, pubsub: Any) -> str:
        """Return the full topic name of a publisher or subscription."""
        return str(_name_of(pubsub))

    def check_connections(self, timeout_seconds: float = 5.0, check_children: bool = True) -> None:
        """Wait until each publisher, subscription and service client has met its other end.

        Args:
            timeout_seconds: 0 checks nothing.
            check_children: also those of `create_child`.

        Raises:
            TimeoutError: some have not; names them.
        """
        if timeout_seconds == 0.0:
            return
        endpoints = self.all_endpoints() if check_children else list(self._endpoints)
        end = time.monotonic() + timeout_seconds
        while True:
            loose = [endpoint for endpoint in endpoints if not _is_connected(endpoint)]
            if not loose:
                return
            if time.monotonic() >= end:
                raise TimeoutError(_complaint(loose, timeout_seconds))
            time.sleep(GRAPH_PERIOD)

    def all_endpoints(self) -> list[Any]:
        """Return what was made with this layer and its children."""
        endpoints = list(self._endpoints)
        for child in self._children:
            endpoints += child.all_endpoints()
        return endpoints


def _profile(depth: int, latch: bool) -> QoSProfile:
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latch else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=depth, durability=durability)


def _is_connected(endpoint: Any) -> bool:
    if hasattr(endpoint, "connected"):
        return bool(endpoint.connected)
    if hasattr(endpoint, "get_subscription_count"):
        return bool(endpoint.get_subscription_count())
    if hasattr(endpoint, "get_publisher_count"):
        return bool(endpoint.get_publisher_count())
    return bool(endpoint.service_is_ready())


def _name_of(endpoint: Any) -> Any:
    for attribute in ("topic", "topic_name", "srv_name"):
        if hasattr(endpoint, attribute):
            return getattr(endpoint, attribute)
    return endpoint


def _complaint(loose: list[Any], timeout: float) -> str:
    groups: dict[str, list[str]] = {}
    for endpoint in loose:
        if isinstance(endpoint, Caller) or hasattr(endpoint, "service_is_ready"):
            what = "nobody serves"
        elif hasattr(endpoint, "send") or hasattr(endpoint, "get_subscription_count"):
            what = "nobody listens to"
        else:
            what = "nobody publishes"
        groups.setdefault(what, []).append(str(_name_of(endpoint)))
    missing = "; ".join(f"{what} {', '.join(names)}" for what, names in groups.items())
    return (
        f"not connected within {timeout:g} s: {missing}. Is the device running, in this namespace?"
    )
