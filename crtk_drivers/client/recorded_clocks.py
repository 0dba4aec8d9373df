"""Writes into a recording how far the clocks of its drivers are off ours, while it runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from queue import Empty, SimpleQueue

from crtk_drivers.client.clock_watch import ClockWatch
from crtk_drivers.client.ros_link import Link
from crtk_drivers.client.topic_recorder import TopicRecorder
from crtk_drivers.recording import Recorder
from crtk_drivers.recording.clock_records import CLOCK, clock_texts
from crtk_drivers.samples import ClockOffset

__all__ = ["RecordedClocks"]


class RecordedClocks:
    """Measures and writes, from its making until `close`.

    Args:
        link: to ROS, started.
        recorder: started.
        topics: knows which drivers there are.
    """

    def __init__(self, link: Link, recorder: Recorder, topics: TopicRecorder) -> None:
        self._recorder = recorder
        self._was_apart: dict[str, bool] = {}
        self._warned: set[str] = set()
        self._news: SimpleQueue[tuple[str, ClockOffset]] = SimpleQueue()
        self._watch = ClockWatch(link, lambda: topics.drivers, self._take)

    def newly_apart(self) -> Iterator[tuple[str, ClockOffset]]:
        """Yield the drivers whose clocks were found apart since this was asked, each once in a recording."""
        while True:
            try:
                yield self._news.get_nowait()
            except Empty:
                return

    def close(self) -> None:
        """Measure no more; what was measured is with the recorder."""
        self._watch.close()

    def _take(self, namespace: str, offset: ClockOffset) -> None:
        texts = clock_texts(namespace, offset, time.time_ns())
        is_other = self._was_apart.get(namespace) is not offset.is_apart
        self._was_apart[namespace] = offset.is_apart
        self._recorder.hold(f"{CLOCK} {namespace}", CLOCK, texts, at_once=is_other)
        if offset.is_apart and namespace not in self._warned:
            self._warned.add(namespace)
            self._news.put((namespace, offset))
