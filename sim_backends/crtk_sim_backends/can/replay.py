"""Plays a candump log onto the bus, at its own pace or another."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Final

from crtk_sim_backends.can import frames
from crtk_sim_backends.can.candump import LogError, Record, read
from crtk_sim_backends.kit.loop import Timer

if TYPE_CHECKING:
    from crtk_sim_backends.can.hub import Hub

_AT_ONCE: Final = 100  # frames, then the loop has its turn
_FULL: Final = 0.001  # s until the next look at a transmit queue


class Replay:
    """A node that sends what a log has; error frames are left out.

    Args:
        hub: the bus.
        path: the log.
        speed: 2.0 is twice as fast as recorded; 0.0 as fast as the bus takes it.
        ended: called after the last frame.

    Raises:
        LogError: when the file cannot be read, or its first line is wrong.
    """

    def __init__(self, hub: Hub, path: Path, speed: float, ended: Callable[[], object]) -> None:
        self.sent = 0
        self.error: str | None = None  # why it has ended early
        self._hub = hub
        self._speed = speed
        self._ended = ended
        records = read(path)
        first = next(records, None)
        if first is None:
            raise LogError(f"the log {path} is empty")
        self._records: Iterator[Record] = chain([first], records)
        self._recorded = first.time
        self._node = hub.attach(lambda can_id, data: None, "replay")
        self._began = 0.0
        self._next: Record | None = None
        self._timer: Timer = hub.call_at(time.monotonic(), self._begin)

    def _begin(self) -> None:
        self._began = time.monotonic()
        self._go_on()

    def _go_on(self) -> None:
        """Send what is due."""
        for _ in range(_AT_ONCE):
            record = self._next or self._read()
            if record is None:
                if not self._hub.waiting(self._node):
                    self.stop()
                    self._ended()
                    return
                due = time.monotonic() + _FULL
                break
            self._next = record
            due = self._due(record)
            if due > time.monotonic():
                break
            if not record.raw[3] & frames.ERROR >> 24:
                if self._hub.transmit(self._node, record.raw):
                    due = time.monotonic() + _FULL
                    break
                self.sent += 1
            self._next = None
        else:
            due = time.monotonic()
        self._timer = self._hub.call_at(due, self._go_on)

    def _read(self) -> Record | None:
        try:
            return next(self._records, None)
        except LogError as error:
            self.error = str(error)
            return None

    def _due(self, record: Record) -> float:
        if not self._speed:
            return 0.0
        return self._began + (record.time - self._recorded) / self._speed

    def stop(self) -> None:
        """Send nothing more; safe to repeat."""
        self._timer.cancel()
        self._node.detach()
