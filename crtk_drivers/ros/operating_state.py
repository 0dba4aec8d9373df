"""``operating_state`` as the official client needs it.

Published on every announcement of the engine, and repeated as a heartbeat: the client subscribes
volatile, and knows nothing until the first message arrives. Stamps increase strictly, because it drops a
message that is not newer than the last. Each busy pulse is kept: it waits for True and then for False.
It also recurses once for each message while it waits, so a flood of announcements (moves refused
thousands of times a second) is thinned out to `SUSTAINED_RATE`; no change of state is held back.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from crtk_msgs.msg import OperatingState as OperatingStateMessage
from rclpy.node import Node

from crtk_drivers.recording import cdr
from crtk_drivers.ros import qos
from crtk_drivers.ros.publishing import Job, PublishingThread
from crtk_drivers.samples import Stamp
from crtk_drivers.state import Status

SUSTAINED_RATE = 20.0
"""Messages a second in the long run, besides the heartbeat."""
BURST = 10.0
"""Messages that may be sent at once."""


class StatusTopic:
    """The topic and what is still to be told on it.

    Args:
        node: in whose namespace it is.
        thread: that publishes.
        status: at the beginning.
        is_told: there is a topic; otherwise it is that of another device that counts.
        before: called by the thread before it tells a status: whoever sees the pulse of a refused move is to
            have been told that it is refused.
    """

    def __init__(
        self,
        node: Node,
        thread: PublishingThread,
        status: Status,
        *,
        is_told: bool = True,
        before: Callable[[], None] = lambda: None,
    ) -> None:
        self._before = before
        self.publisher = (
            qos.publisher(node, OperatingStateMessage, "operating_state", qos.OPERATING_STATE)
            if is_told
            else None
        )
        self.job: Job = thread.job("operating_state", self._publish)
        self._lock = threading.Lock()
        self._pending: deque[tuple[Status, int]] = deque()
        self._told = status
        self._last_ns = 0
        self._allowance = BURST
        self._counted = time.monotonic()

    def announce(self, status: Status, stamp: Stamp) -> None:
        """Tell it as soon as possible. Any thread."""
        with self._lock:
            pending = self._pending
            if _is_second_pulse([*(told for told, _ in pending), status]):
                pending.pop()
                pending.pop()
            pending.append((status, stamp.wall_ns))
        self.job.ask()

    def next_stamp(self, nanoseconds: int) -> int:
        """Return `nanoseconds`, or what is just newer than the last stamp given out."""
        with self._lock:
            self._last_ns = max(nanoseconds, self._last_ns + 1)
            return self._last_ns

    def _publish(self) -> None:
        self._refill()
        with self._lock:
            idle = not self._pending
        if idle:
            self._send(self._told, time.time_ns())
            return
        while True:
            with self._lock:
                if not self._pending:
                    return
                status, stamp_ns = self._pending[0]
                pulses = all(told.state is self._told.state for told, _ in self._pending)
                if pulses and self._allowance < 1.0:
                    self.job.run_again((1.0 - self._allowance) / SUSTAINED_RATE)
                    return
                self._pending.popleft()
            self._allowance = max(0.0, self._allowance - 1.0)
            self._before()
            self._send(status, stamp_ns)

    def _refill(self) -> None:
        now = time.monotonic()
        gained = (now - self._counted) * SUSTAINED_RATE
        self._allowance = min(BURST, self._allowance + gained)
        self._counted = now

    def _send(self, status: Status, stamp_ns: int) -> None:
        self._told = status
        if self.publisher is not None:
            self.publisher.publish(cdr.encode(status, self.next_stamp(stamp_ns)))


def _is_second_pulse(untold: list[Status]) -> bool:
    """Whether the last two are a pulse as the two before, so that one of them is enough.

    Both halves of the first must be untold: who waits since then has not seen them.
    """
    if len(untold) < 4:
        return False
    first, between, second, last = untold[-4:]
    is_pulse = first.is_busy and replace(first, is_busy=False) == between
    return is_pulse and (first, between) == (second, last)
