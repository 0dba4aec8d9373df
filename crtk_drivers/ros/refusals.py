"""``refusals``: why commands were not executed, on a topic and in the log.

JSON in a std_msgs/String, reliable and latched (the last ten):

    {"command": "servo_jp", "reason": "wrong_size", "message": "...", "remedy": "...", "count": 3}

`reason` is a member of `crtk_drivers.errors.Reason`, `count` how often this command has been refused for
this reason since the start. A pair of command and reason is told once in `INTERVAL` seconds; refusals in
between are counted, and told when the interval is over.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from dataclasses import dataclass

from rclpy.node import Node
from std_msgs.msg import String

from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.ros import qos
from crtk_drivers.ros.publishing import PublishingThread

logger = logging.getLogger(__name__)

INTERVAL = 2.0
SWEEP_RATE = 2.0
"""Hz at which refusals that were held back are looked for."""


@dataclass(slots=True)
class _Kind:
    latest: CommandRefused
    count: int = 0
    told_count: int = 0
    told_at: float = -INTERVAL


class RefusalTopic:
    """The topic, and a counter for each command and reason."""

    def __init__(self, node: Node, thread: PublishingThread) -> None:
        self._publisher = qos.publisher(node, String, "refusals", qos.REFUSALS)
        self._job = thread.job("refusals", self._publish, SWEEP_RATE)
        self._lock = threading.Lock()
        self._kinds: dict[tuple[str, Reason], _Kind] = {}

    def add(self, refusal: CommandRefused) -> None:
        """Count it, and tell it if nothing of its kind was told of late. Any thread."""
        now = time.monotonic()
        with self._lock:
            kind = self._kinds.setdefault(
                (refusal.command, refusal.reason), _Kind(refusal, told_at=now - INTERVAL)
            )
            kind.latest = refusal
            kind.count += 1
            due = now - kind.told_at >= INTERVAL
        if due:
            self._job.ask()

    def _publish(self) -> None:
        for refusal, count, new in self._due(time.monotonic()):
            content = {
                "command": refusal.command,
                "reason": refusal.reason.value,
                "message": refusal.detail,
                "remedy": refusal.remedy,
                "count": count,
            }
            self._publisher.publish(String(data=json.dumps(content)))
            logger.warning("%s%s", refusal, f" ({new} times)" if new > 1 else "")

    def _due(self, now: float) -> list[tuple[CommandRefused, int, int]]:
        due = []
        with self._lock:
            for kind in self._kinds.values():
                if kind.count > kind.told_count and now - kind.told_at >= INTERVAL:
                    due.append((kind.latest, kind.count, kind.count - kind.told_count))
                    kind.told_count, kind.told_at = kind.count, now
        return due
