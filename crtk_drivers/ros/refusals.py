"""``refusals``: why commands were not executed, on a topic and in the log.

JSON in a std_msgs/String, reliable and latched (the last ten):

    {"command": "servo_jp", "reason": "wrong_size", "message": "...", "remedy": "...", "count": 3,
     "stamp": {"sec": 1763700000, "nanosec": 500000000}}

`reason` is a member of `crtk_drivers.errors.Reason`, `count` how often this command has been refused for
this reason since the start, `stamp` that of the command's header (zero if it had none). Of a stream, a pair
of command and reason is told once in `INTERVAL` seconds; refusals in between are counted, and told when the
interval is over. Each refused move and state command is told. The refusal of a ``state_command`` has one more
key, `state_command`: what was asked for, such as "enable".
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass

from rclpy.node import Node
from std_msgs.msg import String

from crtk_drivers.commands import find, is_name
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.ros import qos
from crtk_drivers.ros.publishing import PublishingThread
from crtk_drivers.session.tape import refusal_text
from crtk_drivers.status.throttle import Throttle

logger = logging.getLogger(__name__)

INTERVAL = 2.0
MOST_AT_ONCE = 50
"""Refused moves that wait for the publishing thread at most."""
SWEEP_RATE = 2.0
"""Hz at which refusals that were held back are looked for."""


@dataclass(slots=True)
class _Kind:
    latest: CommandRefused
    count: int = 0
    told_count: int = 0
    told_at: float = -INTERVAL


class RefusalTopic:
    """The topic, and a counter for each command and reason.

    Attributes:
        is_told: if not, refusals go to the log alone.
    """

    def __init__(self, node: Node, thread: PublishingThread) -> None:
        self.is_told = True
        self._publisher = qos.publisher(node, String, "refusals", qos.REFUSALS)
        self._job = thread.job("refusals", self.publish, SWEEP_RATE)
        self._lock = threading.Lock()
        self._kinds: dict[tuple[str, Reason], _Kind] = {}
        self._each: deque[tuple[CommandRefused, int]] = deque(maxlen=MOST_AT_ONCE)
        self._logged = Throttle(INTERVAL)

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
            if not _is_stream(refusal.command):
                self._each.append((refusal, kind.count))
                kind.told_count = kind.count
                due = True
        if due:
            self._job.ask()

    def publish(self) -> None:
        """Tell what is to be told now. The publishing thread only."""
        now = time.monotonic()
        with self._lock:
            each, self._each = self._each, deque(maxlen=MOST_AT_ONCE)
        for refusal, count in each:
            self._tell(refusal, count)
            if refusal.reason is Reason.FAILED:
                continue  # the fault, or the warning of what broke it off, has been logged
            if self._logged.passes(f"{refusal.command} {refusal.reason}", now):
                logger.warning("%s", refusal)
        for refusal, count, new in self._due(now):
            self._tell(refusal, count)
            logger.warning("%s%s", refusal, f" ({new} times)" if new > 1 else "")

    def _tell(self, refusal: CommandRefused, count: int) -> None:
        if not self.is_told:
            return
        self._publisher.publish(String(data=refusal_text(refusal, count)))

    def _due(self, now: float) -> list[tuple[CommandRefused, int, int]]:
        due = []
        with self._lock:
            for kind in self._kinds.values():
                if kind.count > kind.told_count and now - kind.told_at >= INTERVAL:
                    due.append((kind.latest, kind.count, kind.count - kind.told_count))
                    kind.told_count, kind.told_at = kind.count, now
        return due


def _is_stream(name: str) -> bool:
    return is_name(name) and find(name).is_stream
