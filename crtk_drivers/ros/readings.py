"""A device's own readings (`crtk_drivers.device.Reading`), latched: each is told when it has changed.

A value that is not known (any more) is not told: ``operating_state`` says whether the device is there.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial

from rclpy.node import Node
from rclpy.publisher import Publisher

from crtk_drivers.device import Reading
from crtk_drivers.engine import Engine
from crtk_drivers.errors import WrongReading
from crtk_drivers.recording import cdr
from crtk_drivers.ros import qos
from crtk_drivers.ros.messages import TYPES
from crtk_drivers.ros.names import Frames
from crtk_drivers.ros.publishing import PublishingThread
from crtk_drivers.samples import Value

RATE = 50.0
"""Hz at which they are looked at."""
REPEATED = 0.05
"""Seconds after which those that repeat are told again."""


@dataclass(slots=True)
class _Topic:
    reading: Reading
    publisher: Publisher
    told: Value | None = None
    told_at: float = 0.0


class ReadingTopics:
    """The topics of one device. None is there if it has no readings."""

    def __init__(
        self, node: Node, thread: PublishingThread, engine: Engine, frames: Frames
    ) -> None:
        self._frames = frames
        self._thread = thread
        self._topics = {
            reading.told_as(name): _Topic(
                reading,
                qos.publisher(node, TYPES[reading.payload], reading.told_as(name), qos.LATCHED),
            )
            for name, reading in engine.readings.items()
        }
        if self._topics:
            thread.job("readings", self._publish, RATE)

    @property
    def publishers(self) -> dict[str, Publisher]:
        """By name, with the sub-namespace."""
        return {name: topic.publisher for name, topic in self._topics.items()}

    def _publish(self) -> None:
        for name, topic in self._topics.items():
            self._thread.attempt(name, partial(self._look, topic))

    def _look(self, topic: _Topic) -> None:
        try:
            value, now = topic.reading.tell(), time.monotonic()
        except WrongReading:  # it has been logged, and will be wrong again
            return
        is_due = topic.reading.repeats and now - topic.told_at >= REPEATED
        if value is None or (value == topic.told and not is_due):
            return
        frame_id = self._frames.outgoing(getattr(value, "frame_id", ""))
        topic.publisher.publish(cdr.encode(value, time.time_ns(), frame_id))
        topic.told, topic.told_at = value, now
