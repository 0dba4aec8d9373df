"""Sends what the trials ask for, and hears what comes of it."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from crtk_drivers.client.conformance.observed import (
    CartesianHeard,
    Endpoint,
    Graph,
    JointsHeard,
    Sent,
    StateHeard,
    Trace,
)
from crtk_drivers.client.conformance.probe.ears import Ears
from crtk_drivers.client.conformance.state_trials import JAWS
from crtk_drivers.client.ros_link import GRAPH_PERIOD
from crtk_drivers.commands import ROS_TYPES, Kind, Level, Payload, find
from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.ros.messages import TYPES, set_stamp

CONNECT_TIME = 5.0
DEPTH = 100
SENT_BY_TWO = ("servo_jv",)
"""What is sent as another client, too."""


class RosProbe:
    """A `crtk_drivers.client.conformance.trial.Probe` over ROS 2.

    Publishers are made at once, so that a stop has nothing to wait for. They are volatile, but where the
    device insists on hearing the past: there a volatile one would not be heard at all.

    Raises:
        ConnectionFailed: the device does not hear one of them.
    """

    def __init__(self, node: Node, graph: Graph, ears: Ears) -> None:
        self._node = node
        self._ears = ears
        self._sent: list[Sent] = []
        self._late: list[float] = []
        self._publishers: dict[str, Any] = {}
        self._seconds: dict[str, Any] = {}
        prefix = f"{graph.namespace.rstrip('/')}/"
        for each, row in graph.commanded():
            space, _, _ = each.name.rpartition("/")
            is_own = not space or space in JAWS or row.level is Level.SETTING
            if is_own and each.ros_type == ROS_TYPES[row.payload]:
                topic = (TYPES[row.payload], f"{prefix}{each.name}", _profile(each))
                self._publishers[each.name] = node.create_publisher(*topic)
                if each.name in SENT_BY_TWO:
                    self._seconds[each.name] = node.create_publisher(*topic)
        every = [*self._publishers.items(), *self._seconds.items()]
        end = time.monotonic() + CONNECT_TIME
        while loose := [n for n, p in every if not p.get_subscription_count()]:
            if time.monotonic() > end:
                raise ConnectionFailed(
                    f"the device does not hear {', '.join(loose)}", where=graph.namespace
                )
            time.sleep(GRAPH_PERIOD)

    def close(self) -> None:
        """Withdraw the publishers, and what they sent."""
        for publisher in (*self._publishers.values(), *self._seconds.values()):
            self._node.destroy_publisher(publisher)
        self._publishers, self._seconds = {}, {}

    def now(self) -> float:
        """Return monotonic s."""
        return time.monotonic()

    def state(self) -> StateHeard | None:
        """Return the newest operating state."""
        return self._ears.state()

    def joints(self, name: str) -> JointsHeard | None:
        """Return the newest joint values of a name."""
        return self._ears.joints(name)

    def cartesian(self, name: str) -> CartesianHeard | None:
        """Return the newest pose, twist or wrench of a name."""
        return self._ears.cartesian(name)

    def number(self, name: str) -> float | None:
        """Return the newest value of a setting."""
        return self._ears.number(name)

    def send(
        self,
        name: str,
        numbers: Sequence[float] = (),
        *,
        text: str = "",
        names: Sequence[str] = (),
        frame: str = "",
        stamped: bool = True,
        second: bool = False,
    ) -> Sent:
        """Send a command; one that the device does not offer in its type is not sent."""
        row = find(name)
        message: Any = TYPES[row.payload]()
        stamp_ns = time.time_ns() if stamped and hasattr(message, "header") else 0
        if hasattr(message, "header"):
            set_stamp(message.header.stamp, stamp_ns)
            message.header.frame_id = frame
        values = [float(each) for each in numbers]
        if row.payload is Payload.TEXT:
            message.string = text
        elif row.payload is Payload.JOINT_STATE:
            message.name = list(names)
            field = {Kind.VELOCITY: "velocity", Kind.EFFORT: "effort"}.get(row.kind, "position")
            setattr(message, field, array("d", values))
        elif row.payload is Payload.NUMBER:
            message.data = values[0]
        elif values:
            _fill(message, row.payload, values)
        sent = Sent(time.monotonic(), stamp_ns, name, tuple(values), text)
        publishers = self._seconds if second else self._publishers
        if name in publishers:
            self._sent.append(sent)
            publishers[name].publish(message)
        return sent

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        due = time.monotonic() + seconds
        time.sleep(seconds)
        self._late.append(time.monotonic() - due)

    def lateness(self) -> float:
        """Return how late it woke up, in s, in one of twenty cases since this was asked last."""
        late, self._late = self._late, []
        return float(np.quantile(late, 0.95)) if late else 0.0

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait until what is heard fulfils a condition; return whether it does."""
        return self._ears.wait(condition, timeout)

    def trace(self, began: float) -> Trace:
        """Return what was heard and sent since then."""
        return self._ears.trace(began, [each for each in self._sent if each.at >= began])

    def forget(self) -> None:
        """Forget what was heard and sent."""
        self._ears.forget()
        self._sent.clear()


def _fill(message: Any, payload: Payload, values: Sequence[float]) -> None:
    if payload is Payload.POSE:
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z, q.x, q.y, q.z, q.w = values
        return
    body = message.twist if payload is Payload.TWIST else message.wrench
    linear, angular = (
        (body.linear, body.angular) if payload is Payload.TWIST else (body.force, body.torque)
    )
    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = values


def _profile(endpoint: Endpoint) -> QoSProfile:
    return QoSProfile(
        depth=DEPTH,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL
        if endpoint.latched
        else DurabilityPolicy.VOLATILE,
    )
