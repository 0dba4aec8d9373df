"""``measured_*``, ``setpoint_*``, ``jacobian``, ``goal_*``, settings and /tf, from the engine's values.

All messages of one cycle come from one sample and carry its stamp. Data that is not valid is published
with stamp 0, as CRTK asks: the official client counts messages, and takes silence for a lost device.
Nothing is stamped anew. A topic that nobody hears is skipped; the first message follows its first
subscriber within one period.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

from rclpy.node import Node
from rclpy.publisher import Publisher
from tf2_msgs.msg import TFMessage

from crtk_drivers.commands import Command, Direction, Level, Payload
from crtk_drivers.engine import Engine
from crtk_drivers.engine.as_messages import Messages
from crtk_drivers.recording import cdr
from crtk_drivers.ros import qos
from crtk_drivers.ros.messages import TYPES
from crtk_drivers.ros.names import Frames
from crtk_drivers.ros.publishing import Job, PublishingThread
from crtk_drivers.samples import JointState, Pose, Poses, Stamp, Twist, Value, Wrench, vector

LATCHED = (Level.GOAL, Level.SETTING)
"""What is told once, and again to those who come later."""

NEVER = Stamp(0, -math.inf)
"""The stamp of what is not known yet."""

AUDIENCE_RATE = 4.0
"""Hz at which it is looked for subscribers, besides when DDS tells of one: some middleware does not."""

COHERENCE_TRIES = 3
"""A new sample may arrive while the values are collected; then they are collected again."""

Values = Mapping[str, tuple[Value, Stamp] | None]


_NOT_KNOWN: Mapping[Payload, Value] = MappingProxyType(
    {
        Payload.JOINT_STATE: JointState(),
        Payload.POSE: Pose(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0))),
        Payload.POSES: Poses(),
        Payload.TWIST: Twist(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0))),
        Payload.WRENCH: Wrench(vector((0.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0))),
    }
)
"""What is published with stamp 0 before a value is known, as ROS makes it. Of other payloads nothing is."""


@dataclass(slots=True, eq=False)
class _Topic:
    """One publisher, with the value that it sent last."""

    name: str
    command: Command
    publisher: Publisher
    sent: Value | None

    def send(self, value: Value | None, stamp: Stamp, messages: Messages) -> None:
        if value is not None:
            self.sent = value
        elif self.sent is None:
            return
        self.publisher.publish(messages.of(self.name, self.command, self.sent, stamp))


def _topic(
    node: Node,
    engine: Engine,
    name: str,
    command: Command,
    matched: Callable[[object], None] | None = None,
) -> _Topic:
    profile = qos.of_feedback(command)
    publisher = qos.publisher(node, TYPES[command.payload], name, profile, matched)
    unknown = _NOT_KNOWN.get(command.payload)
    return _Topic(name, command, publisher, unknown)


def coherent(engine: Engine, names: Iterable[str]) -> Values:
    """Return the values of `names`, all of one sample."""
    for _ in range(COHERENCE_TRIES):
        values = {name: engine.feedback(name) for name in names}
        stamps = {found[1].monotonic for found in values.values() if found is not None}
        if len(stamps) <= 1:
            break
    return values


class FeedbackTopics:
    """Everything that is published continuously."""

    def __init__(self, node: Node, thread: PublishingThread, engine: Engine) -> None:
        self._engine = engine
        self._thread = thread
        self._audience = audience = thread.job("audience", self._look, AUDIENCE_RATE)
        self._topics = [
            _topic(node, engine, name, command, lambda _: audience.ask())
            for name, command in engine.commands.items()
            if command.direction is Direction.PUBLISHED
            and command.level not in (Level.STATE, *LATCHED)
        ]
        self._heard: list[_Topic] = []
        self._rate = self._paced = 0.0
        self._job = thread.job("feedback", self._publish)

    @property
    def publishers(self) -> dict[str, Publisher]:
        """By CRTK name."""
        return {topic.name: topic.publisher for topic in self._topics}

    def set_rate(self, rate: float) -> None:
        """Publish `rate` times a second; at the device's own rate, each sample once and at once."""
        self._rate = rate
        self._audience.ask()

    def _look(self) -> None:
        """See who listens; where nobody does, nothing is done for a sample."""
        heard = [topic for topic in self._topics if topic.publisher.get_subscription_count() > 0]
        rate = self._rate if heard else 0.0
        if (heard, rate) == (self._heard, self._paced):
            return
        self._heard, self._paced = heard, rate
        job = self._job
        job.follows = math.isclose(rate, self._engine.capabilities.rate, rel_tol=0.01)
        self._engine.on_sample = job.ask if job.follows else None
        job.set_rate(rate)

    def _publish(self) -> None:
        values = coherent(self._engine, [topic.name for topic in self._heard])
        for topic in self._heard:
            self._thread.attempt(topic.name, partial(self._send, topic, values[topic.name]))

    def _send(self, topic: _Topic, found: tuple[Value, Stamp] | None) -> None:
        if found is None:
            topic.send(None, NEVER, self._engine.messages)
        else:
            topic.send(*found, self._engine.messages)


class LatchedTopics:
    """Goals and settings, latched, each published when it has a new value."""

    def __init__(self, node: Node, thread: PublishingThread, engine: Engine) -> None:
        self._engine = engine
        self._topics = [
            _topic(node, engine, name, command)
            for name, command in engine.commands.items()
            if command.level in LATCHED and command.direction is Direction.PUBLISHED
        ]
        self._thread = thread
        self.job: Job = thread.job("latched", self._publish)
        self._published: dict[str, Value] = {}

    @property
    def publishers(self) -> dict[str, Publisher]:
        """By CRTK name."""
        return {topic.name: topic.publisher for topic in self._topics}

    def _publish(self) -> None:
        for topic in self._topics:
            found = self._engine.latched(topic.name)
            if found is None or self._published.get(topic.name) is found[0]:
                continue
            if self._thread.attempt(topic.name, partial(topic.send, *found, self._engine.messages)):
                self._published[topic.name] = found[0]


class Transforms:
    """``measured_cp`` on /tf, from the base frame to the tool frame. Never from ``local/``."""

    def __init__(
        self, node: Node, thread: PublishingThread, engine: Engine, frames: Frames
    ) -> None:
        self._engine = engine
        self.job: Job = thread.job("tf", self._publish)
        self._publisher: Publisher | None = None
        if "measured_cp" in engine.commands:
            self._publisher = qos.publisher(node, TFMessage, "/tf", qos.TF)
        outgoing, capabilities = frames.outgoing, engine.capabilities
        self._frames = outgoing(capabilities.base_frame), outgoing(capabilities.tool_frame)
        self._last_ns = 0

    def _publish(self) -> None:
        if self._publisher is None or self._publisher.get_subscription_count() == 0:
            return
        found = self._engine.feedback("measured_cp")
        # Listeners complain of a stamp that comes twice, and cannot use one that is 0.
        if found is None or found[1].wall_ns in (0, self._last_ns):
            return
        pose, stamp = found
        assert isinstance(pose, Pose)
        self._last_ns = stamp.wall_ns
        self._publisher.publish(cdr.encode_transform(pose, stamp.wall_ns, *self._frames))
