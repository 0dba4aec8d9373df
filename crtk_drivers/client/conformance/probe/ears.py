"""Everything that a device says, kept as it came until it is read."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from crtk_drivers.client.conformance.observed import (
    CartesianHeard,
    Endpoint,
    Graph,
    JointsHeard,
    Sent,
    StateHeard,
    Trace,
)
from crtk_drivers.client.conformance.probe.heard_messages import (
    Raw,
    cartesian_heard,
    joints_heard,
    matrix_heard,
    state_heard,
    transforms_heard,
)
from crtk_drivers.commands import ROS_TYPES, Command, Level, Payload
from crtk_drivers.ros.messages import TYPES

DEPTH = 1000
"""Messages that may wait: what is lost here would count against the device."""
LARGEST = 200_000
"""Messages of a topic that are kept."""
_CARTESIAN = (Payload.POSE, Payload.TWIST, Payload.WRENCH)


class Ears:
    """Subscriptions to all that a device publishes under CRTK names of CRTK types.

    Args:
        node: that somebody spins.
        graph: of the device.
    """

    def __init__(self, node: Node, graph: Graph) -> None:
        self._node = node
        self._prefix = f"{graph.namespace.rstrip('/')}/"
        self._arrived = threading.Condition()
        self._heard: dict[str, deque[Raw]] = {}
        self._rows: dict[str, Command] = {}
        self._subscriptions: dict[str, Any] = {}
        self._nodes = {each.node for each, _ in graph.published()}
        offered: dict[str, list[Endpoint]] = {}
        for each, row in graph.published():
            if each.ros_type == ROS_TYPES[row.payload]:
                self._rows[each.name] = row
                offered.setdefault(each.name, []).append(each)
        for name, endpoints in offered.items():
            row = self._rows[name]
            profile = _as_offered(endpoints, row.level is not Level.STATE)
            self._listen(name, f"{self._prefix}{name}", TYPES[row.payload], profile)
        self._listen("/tf", "/tf", TFMessage, _profile(True, False))
        self._listen("/rosout", "/rosout", Log, _profile(True, False))
        if any(each.name == "refusals" for each in graph.endpoints):
            self._listen("refusals", f"{self._prefix}refusals", String, _profile(True, False))

    def _listen(self, name: str, topic: str, kind: type, profile: QoSProfile) -> None:
        heard = self._heard[name] = deque(maxlen=LARGEST)

        def receive(message: Any) -> None:
            raw = Raw(time.monotonic(), time.time_ns(), message)
            with self._arrived:
                heard.append(raw)
                self._arrived.notify_all()

        self._subscriptions[name] = self._node.create_subscription(kind, topic, receive, profile)

    def drop(self, names: Iterable[str]) -> None:
        """Listen to some no more."""
        for name in names:
            if name in self._subscriptions:
                self._node.destroy_subscription(self._subscriptions.pop(name))

    def forget(self) -> None:
        """Forget what was heard, but for the newest message of each topic."""
        with self._arrived:
            for heard in self._heard.values():
                while len(heard) > 1:
                    heard.popleft()

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait until a condition of what was heard holds; return whether it does."""
        with self._arrived:
            return self._arrived.wait_for(condition, timeout)

    def count(self, name: str) -> int:
        """Return how many messages of a topic are kept."""
        return len(self._heard.get(name, ()))

    def state(self) -> StateHeard | None:
        """Return the newest operating state."""
        raw = self._newest("operating_state")
        return None if raw is None else state_heard(raw)

    def joints(self, name: str) -> JointsHeard | None:
        """Return the newest joint values of a name."""
        raw = self._newest(name)
        return None if raw is None else joints_heard(raw)

    def cartesian(self, name: str) -> CartesianHeard | None:
        """Return the newest pose, twist or wrench of a name."""
        raw = self._newest(name)
        return None if raw is None else cartesian_heard(raw, self._rows[name].payload)

    def number(self, name: str) -> float | None:
        """Return the newest value of a setting."""
        raw = self._newest(name)
        return None if raw is None else float(raw.message.data)

    def _newest(self, name: str) -> Raw | None:
        heard = self._heard.get(name)
        return heard[-1] if heard else None

    def trace(
        self,
        began: float,
        sent: Iterable[Sent] = (),
        marks: Mapping[str, float] | None = None,
    ) -> Trace:
        """Return what was heard since `began`."""
        ended = time.monotonic()
        with self._arrived:
            kept = {n: [r for r in heard if r.at >= began] for n, heard in self._heard.items()}

        def of(*payloads: Payload) -> dict[str, list[Raw]]:
            return {n: kept[n] for n, r in self._rows.items() if r.payload in payloads and kept[n]}

        states = kept.get("operating_state", [])
        return Trace(
            began,
            ended,
            {n: tuple(map(joints_heard, raws)) for n, raws in of(Payload.JOINT_STATE).items()},
            {
                name: tuple(cartesian_heard(raw, self._rows[name].payload) for raw in raws)
                for name, raws in of(*_CARTESIAN).items()
            },
            {n: tuple(map(matrix_heard, raws)) for n, raws in of(Payload.MATRIX).items()},
            tuple(map(state_heard, states)),
            tuple(each for raw in kept["/tf"] for each in transforms_heard(raw)),
            tuple(sent),
            tuple(self._told(kept)),
            marks or {},
        )

    def _told(self, kept: Mapping[str, list[Raw]]) -> list[tuple[float, str]]:
        loggers = {each.strip("/").replace("/", ".") for each in self._nodes}
        records = [
            (raw.at, str(raw.message.msg)) for raw in kept["/rosout"] if raw.message.name in loggers
        ]
        refusals = [(raw.at, str(raw.message.data)) for raw in kept.get("refusals", ())]
        return sorted(records + refusals)

    def close(self) -> None:
        """Listen no more."""
        self.drop(tuple(self._subscriptions))


def _as_offered(endpoints: Iterable[Endpoint], may_be_latched: bool) -> QoSProfile:
    """Return what all publishers of a name can serve; the heartbeat is heard by who asks for no past."""
    found = tuple(endpoints)
    return _profile(
        all(each.reliable for each in found),
        may_be_latched and all(each.latched for each in found),
    )


def _profile(reliable: bool, latched: bool) -> QoSProfile:
    return QoSProfile(
        depth=DEPTH,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
