"""Messages in the order of their log times: in a file they may be a little out of order."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from typing import Final

from crtk_drivers.recording.mcap_reader import Message

WINDOW: Final = 1_000_000_000
"""Nanoseconds by which a message may be in the wrong place."""


def in_order(messages: Iterable[Message], window: int = WINDOW) -> Iterator[Message]:
    """Yield messages by log time; one that is out of place by more than `window` (ns) comes when found."""
    waiting: list[tuple[int, int, Message]] = []
    for number, message in enumerate(messages):
        heapq.heappush(waiting, (message.log_time, number, message))
        while waiting[0][0] < message.log_time - window:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]
