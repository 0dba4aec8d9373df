"""The client's side of ROS: a node, its endpoints by topic, and what the graph says of the other side.

The rest of `crtk_drivers.client` is made of these and of `inbox`, and imports no ROS itself.
"""

from __future__ import annotations

import atexit
import itertools
import logging
import math
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import rclpy
from crtk_msgs.srv import TriggerOperatingState
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Empty, String

from crtk_drivers.client.inbox import Inbox, Received, may_wait
from crtk_drivers.commands import Payload
from crtk_drivers.errors import (
    ConnectionFailed,
    ConnectionLost,
    DataTimeout,
    KinematicsError,
)
from crtk_drivers.recording import cdr
from crtk_drivers.ros import environment, qos
from crtk_drivers.ros.messages import TYPES, pose_of, set_pose, stamp_ns
from crtk_drivers.ros.plain import fill_plain
from crtk_drivers.ros.spinning import SPIN_PERIOD, make_executor, spin
from crtk_drivers.ros.unlocked import is_acknowledged
from crtk_drivers.samples import Pose, Text, Value, Vector, vector

logger = logging.getLogger(__name__)

GRAPH_PERIOD = 0.005
"""Seconds between two looks at the graph while something is waited for."""

_numbers = itertools.count(1)


AGAIN = 0.5
"""Seconds after which a question without an answer is asked again, then twice as many."""

UNSPUN = 0.5
"""Seconds after which an executor is taken for one that nobody spins."""


class Outbox:
    """One topic that is sent on. Thread-safe. Made by `Link`."""

    was_connected = False

    def __init__(self, topic: str, publisher: Any, message_type: type) -> None:
        self.topic = topic
        self._publisher = publisher
        self._type = message_type
        self._has_header = hasattr(message_type, "header")

    def stamp(self, value: Any) -> int:
        """Return the stamp (ns) that `value` goes out with: its own if it is a ready message, else now."""
        if self._has_header and self.accepts(value):
            return stamp_ns(value.header.stamp)
        return time.time_ns() if self._has_header else 0

    def send(self, value: Value | str | None, frame_id: str = "", stamp: int = 0) -> None:
        """Send a value, a text, or nothing but the message; stamped now unless `stamp` (ns) is given.

        Raises:
            ConnectionLost: nobody listens.
        """
        if not self.connected:
            raise ConnectionLost(
                f"nobody listens to {self.topic} any more",
                remedy="Was the driver stopped? It is found again when it is back.",
            )
        self.publish(value, frame_id, stamp)

    def publish(self, value: Value | str | None, frame_id: str = "", stamp: int = 0) -> None:
        """As `send`, whether anybody listens or not."""
        if value is None:
            self._publisher.publish(self._type())
            return
        told = Text(value) if isinstance(value, str) else value
        self._publisher.publish(cdr.encode(told, stamp or time.time_ns(), frame_id))

    def send_message(self, message: Any) -> None:
        """Send a ready message of the topic's type."""
        self._publisher.publish(message)

    def accepts(self, message: object) -> bool:
        """Whether `message` is a ready message of the topic's type."""
        return isinstance(message, self._type)

    def confirmed(self, timeout: float) -> bool:
        """Whether all who listen reliably confirm within `timeout` s that they have what was sent.

        DDS confirms it: no callback has to run here or there. A middleware that cannot tell is believed.
        """
        try:
            return is_acknowledged(self._publisher, timeout)
        except InvalidHandle:
            return False  # it was closed meanwhile
        except RuntimeError as error:
            logger.debug("%s: it is not told whether a message arrived: %s", self.topic, error)
            return True

    @property
    def listeners(self) -> int:
        """How many listen, reliably or not."""
        return int(self._publisher.get_subscription_count())

    @property
    def connected(self) -> bool:
        """Whether somebody listens."""
        return bool(self.listeners)


class Caller:
    """One service that is called. Thread-safe. Made by `Link`."""

    was_connected = False

    def __init__(self, name: str, client: Any, service_type: type) -> None:
        self.topic = name
        self._client = client
        self._type = service_type

    @property
    def connected(self) -> bool:
        """Whether somebody serves it."""
        return bool(self._client.service_is_ready())

    def call(self, timeout: float, **fields: Any) -> Any:
        """Return the answer to a request with these fields.

        Raises:
            ConnectionFailed: nobody serves it.
            DataTimeout: no answer in `timeout` s.
        """
        return self._ask(self._filled(fields), timeout)

    def query(self, timeout: float, **fields: Any) -> Any:
        """Return the answer to a request that changes nothing, as `call`; it is asked again where none comes.

        The first answer to a client that the other side has not found yet is lost.
        """
        return self._ask(self._filled(fields), timeout, AGAIN)

    def _filled(self, fields: Mapping[str, Any]) -> Any:
        request: Any = self._type.Request()  # type: ignore[attr-defined]
        for name, value in fields.items():
            setattr(request, name, value)
        return request

    def call_plain(self, timeout: float, fields: Mapping[str, Any]) -> Any:
        """Return the answer to a request with fields as plain data; see `call` and `fill_plain`."""
        request: Any = self._type.Request()  # type: ignore[attr-defined]
        fill_plain(request, fields)
        return self._ask(request, timeout)

    def _ask(self, request: Any, timeout: float, again: float = math.inf) -> Any:
        may_wait(f"calling {self.topic}")
        deadline = time.monotonic() + timeout
        if not wait_connected([self], deadline):
            raise ConnectionFailed(
                f"nobody serves {self.topic}", remedy="Is the driver running, in this ROS domain?"
            )
        answered, asked = threading.Event(), []
        while True:
            future = self._client.call_async(request)
            future.add_done_callback(lambda _: answered.set())
            asked.append(future)
            left = max(0.0, deadline - time.monotonic())
            if answered.wait(min(again, left)) or left <= again:
                break
            again *= 2.0
        done = next((each for each in asked if each.done()), None)
        for each in asked:
            if each is not done:
                self._client.remove_pending_request(each)
        if done is None:
            raise DataTimeout(
                f"{self.topic} did not answer in {timeout:g} s",
                remedy="Give a longer timeout; if the node is your own, is it spun?",
            )
        return done.result()

    def forward_kinematics(self, joints: Vector, timeout: float) -> Pose:
        """Return the pose of a joint position (n,).

        Raises:
            KinematicsError: the device answers that there is none, and why.
        """
        answer = self.query(timeout, jp=joints.tolist())
        if not answer.result:
            raise KinematicsError(answer.message or "no reason given", where=self.topic)
        return pose_of(answer.cp)

    def inverse_kinematics(self, pose: Pose, reference: Vector, timeout: float) -> Vector:
        """Return the joint position (n,) of a pose, nearest to `reference`.

        Raises:
            KinematicsError: the device answers that there is none, and why.
        """
        wanted = TYPES[Payload.POSE]().pose
        set_pose(wanted, pose)
        answer = self.query(timeout, cp=wanted, jp=reference.tolist())
        if not answer.result:
            raise KinematicsError(answer.message or "no reason given", where=self.topic)
        return vector(answer.jp)

    def operating_state(self, timeout: float) -> Received:
        """Return the status that TriggerOperatingState answers with."""
        message = self.query(timeout).operating_state
        data, stamp = serialize_message(message), stamp_ns(message.header.stamp)
        now = time.monotonic()
        return Received(data, type(message), stamp, now, 0, now)


Endpoint = Inbox | Outbox | Caller


def wait_connected(endpoints: Sequence[Endpoint], deadline: float) -> bool:
    """Wait until all `endpoints` have met their other end; return whether they did in time."""
    while not all(endpoint.connected for endpoint in endpoints):
        if time.monotonic() >= deadline:
            return False
        time.sleep(GRAPH_PERIOD)
    for endpoint in endpoints:
        endpoint.was_connected = True
    return True


class Link:
    """A node with endpoints that are made when they are first asked for. Thread-safe.

    Args:
        name: of the node, if one is made.
        node: your own; then you spin it, and it is not destroyed here.
        executor: your own; a node is made and added to it, and you spin it.
        ros_args: for the node that is made: ``["--ros-args", "-r", "/a:=/b"]``.
        domain: of ROS, for the node that is made; None: that of the environment.

    Raises:
        ConfigError: the ROS arguments cannot be used.
    """

    def __init__(
        self,
        name: str = "crtk_client",
        *,
        node: Node | None = None,
        executor: Executor | None = None,
        ros_args: Sequence[str] = (),
        domain: int | None = None,
    ) -> None:
        self._lock = threading.RLock()
        self._inboxes: dict[str, Inbox] = {}
        self._outboxes: dict[str, Outbox] = {}
        self._callers: dict[str, Caller] = {}
        self._context: Context | None = None
        self._executor = executor
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._owns_node = node is None
        if node is None:
            context = (
                executor.context if executor is not None else self._own_context(ros_args, domain)
            )
            node = rclpy.create_node(
                f"{name}_{os.getpid()}_{next(_numbers)}",
                context=context,
                cli_args=list(ros_args) if executor is not None else None,
                enable_rosout=False,
                start_parameter_services=False,
            )
            if executor is not None:
                executor.add_node(node)
        self.node = node

    def _own_context(self, ros_args: Sequence[str], domain: int | None) -> Context:
        context = Context()
        try:
            rclpy.init(
                args=list(ros_args),
                context=context,
                domain_id=domain,
                signal_handler_options=SignalHandlerOptions.NO,
            )
        except Exception as error:
            raise environment.not_started(error, ros_args) from error
        self._context = context
        return context

    def start(self) -> None:
        """Spin, if the node is this link's own and no executor was given."""
        if self._context is None or self._thread is not None:
            return
        self._executor = make_executor(self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(
            target=spin, args=(self._executor, self._stop), name="crtk client", daemon=True
        )
        self._thread.start()
        atexit.register(self.close)

    @property
    def is_open(self) -> bool:
        """Whether neither it was closed nor ROS shut down."""
        return not self._stop.is_set() and bool(self.node.context.ok())

    def close(self) -> None:
        """End everything that this link made. May be called twice; not from a callback."""
        atexit.unregister(self.close)
        self._stop.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(10.0 * SPIN_PERIOD)
        self._where_it_is_spun(self._destroy)
        if self._context is not None and self._executor is not None:
            self._executor.shutdown(timeout_sec=SPIN_PERIOD)
        if self._context is not None:
            self._context.try_shutdown()

    def _where_it_is_spun(self, work: Callable[[], None]) -> None:
        """Do it in the thread of somebody else's executor: it raises where what it waits for is destroyed."""
        if self._thread is None and self.node.executor is not None:
            is_done = threading.Event()

            def work_there() -> None:
                work()
                is_done.set()

            self.node.executor.create_task(work_there)
            is_done.wait(UNSPUN)
        work()

    def _destroy(self) -> None:
        """Take back what was made of the node. The second time does nothing."""
        with self._lock:
            for box in self._inboxes.values():
                self.node.destroy_subscription(box.subscription)
            for outbox in self._outboxes.values():
                self.node.destroy_publisher(outbox._publisher)  # noqa: SLF001 - made here
            for caller in self._callers.values():
                self.node.destroy_client(caller._client)  # noqa: SLF001 - made here
            self._inboxes, self._outboxes, self._callers = {}, {}, {}
            if self._owns_node:
                if self._executor is not None:
                    self._executor.remove_node(self.node)
                self.node.destroy_node()
                self._owns_node = False

    # ------------------------------------------------------------------------------------ endpoints

    def inbox(self, topic: str, message_type: type, latched: bool | None = None) -> Inbox:
        """Return the subscription of a topic.

        Args:
            topic: full name.
            message_type: ROS class.
            latched: ask for what was said before; None: hear all that publish it now, as they offer it.
        """
        with self._lock:
            if topic not in self._inboxes:
                if latched is None:
                    profile = qos.as_offered(self._offered(topic), qos.DATA.depth)
                else:
                    profile = qos.REFUSALS if latched else qos.DATA
                keeps = profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
                box = Inbox(topic, message_type, keeps)
                box.subscription = self.node.create_subscription(
                    message_type, topic, box.receive, profile, raw=True
                )
                self._inboxes[topic] = box
            return self._inboxes[topic]

    def text_inbox(self, topic: str, latched: bool = True) -> Inbox:
        """Return the subscription of a std_msgs/String."""
        return self.inbox(topic, String, latched)

    def outbox(self, topic: str, payload: Payload) -> Outbox:
        """Return the publisher of a topic."""
        kind = Empty if payload is Payload.EMPTY else TYPES[payload]
        with self._lock:
            if topic not in self._outboxes:
                # Volatile: a driver that starts later must not get the commands of before.
                once = payload in (Payload.EMPTY, Payload.TEXT)
                profile = qos.CONFIRMED if once else qos.DATA
                publisher = self.node.create_publisher(kind, topic, profile)
                self._outboxes[topic] = Outbox(topic, publisher, kind)
            return self._outboxes[topic]

    def caller(self, name: str, service_type: type) -> Caller:
        """Return the client of a service."""
        with self._lock:
            if name not in self._callers:
                client = self.node.create_client(service_type, name)
                self._callers[name] = Caller(name, client, service_type)
            return self._callers[name]

    def state_caller(self, name: str) -> Caller:
        """Return the client of an ``operating_state`` service."""
        return self.caller(name, TriggerOperatingState)

    @property
    def endpoints(self) -> dict[str, Endpoint]:
        """All endpoints that were made, by full name."""
        with self._lock:
            return {**self._callers, **self._inboxes, **self._outboxes}

    # ---------------------------------------------------------------------------------------- graph

    def topics(self) -> dict[str, list[str]]:
        """Return the types of each topic that anybody uses, this link included."""
        return dict(self.node.get_topic_names_and_types())

    def services(self) -> dict[str, list[str]]:
        """Return the types of each service that anybody serves."""
        return dict(self.node.get_service_names_and_types())

    def publishers(self, topic: str) -> int:
        """Return how many publish a topic."""
        return int(self.node.count_publishers(topic))

    def subscribers(self, topic: str) -> int:
        """Return how many listen to a topic."""
        return int(self.node.count_subscribers(topic))

    def is_latched(self, topic: str) -> bool:
        """Whether all that publish a topic offer what was said before; False if nobody does."""
        profile = qos.as_offered(self._offered(topic), qos.DATA.depth)
        return profile.durability is DurabilityPolicy.TRANSIENT_LOCAL

    def _offered(self, topic: str) -> list[QoSProfile]:
        return [each.qos_profile for each in self.node.get_publishers_info_by_topic(topic)]
