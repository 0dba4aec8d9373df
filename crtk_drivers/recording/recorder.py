"""Takes values from the thread that reads a device, and writes them in a thread of its own.

Whoever hands a value over never waits for a disk: it lies in a queue, of which the oldest goes when it is
full. What is lost is counted, told, and written into the recording. A disk that is full ends neither the
recording nor the device: it is told, and tried again with what comes next.
"""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Self

from crtk_drivers.errors import RecordingError, unexpected
from crtk_drivers.recording import cdr
from crtk_drivers.recording.mcap_writer import McapWriter
from crtk_drivers.samples import Stamp, Value
from crtk_drivers.state import Status

__all__ = ["Recorder", "Totals"]

PERIOD: Final = 0.05
"""Seconds between two writes: what is lost at most if the process is killed."""

CAPACITY: Final = 100_000
"""Values that wait at most: half a minute of six topics at 500 Hz."""

CLOSE_TIMEOUT: Final = 10.0
"""Seconds in which what waits must have been written at the end."""

TOTALS: Final = "crtk_drivers recording"
"""Name of the metadata that a recording ends with: `Totals`."""

logger = logging.getLogger(__name__)

_Taken = tuple[int, str, Value | Status, int, int]


@dataclass(frozen=True, slots=True)
class Totals:
    """How a recording went.

    Attributes:
        taken: values that were handed over.
        written: of these, in the file.
        lost: of these, not in it: the queue or the disk was full.
        unsuited: of these, not in it: no message can hold them.
        error: what went wrong last; empty if nothing did.
    """

    taken: int
    written: int
    lost: int
    unsuited: int
    error: str


class Recorder:
    """Records what it is given, from `start` to `close`.

    Args:
        path: of the file, which is made here.
        metadata: texts by name, by name; written first.
        attachments: files that go with it, by name.
        frame_id: of values that do not name their own.
        period: seconds between two writes.
        capacity: values that wait at most.

    Raises:
        RecordingError: the file cannot be made.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        frame_id: str = "",
        period: float = PERIOD,
        capacity: int = CAPACITY,
    ) -> None:
        self._writer = _begun(path, metadata or {}, attachments or {})
        self._frame_id = frame_id
        self._period = period
        self._queue: deque[_Taken] = deque(maxlen=capacity)
        self._numbers = itertools.count(1)
        self._newest = 0
        self._drained = 0
        self._channels: dict[str, tuple[str, int]] = {}
        self._unsuited: Counter[str] = Counter()
        self._added = 0
        self._refused = 0
        self._error = ""
        self._is_failing = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)

    def start(self) -> None:
        """Begin to write; what was taken before is written too."""
        self._thread.start()

    def take(self, topic: str, value: Value | Status, stamp: Stamp) -> None:
        """Record a value. Never waits, never raises; may be called from any thread.

        Args:
            topic: with its namespace: ``/arm/measured_js``.
            value: one that cannot be recorded is counted as `Totals.unsuited`.
            stamp: when it was measured; `wall_ns` 0 marks data that is not valid.
        """
        self._queue.append((next(self._numbers), topic, value, stamp.wall_ns, time.time_ns()))

    @property
    def totals(self) -> Totals:
        """How it goes. What waits to be written is no loss."""
        lost = self._newest - self._drained + self._refused + self._writer.lost
        written = self._added - self._writer.lost
        return Totals(self._newest, written, lost, self._unsuited.total(), self._error)

    def close(self, timeout: float = CLOSE_TIMEOUT) -> Totals:
        """Write what waits, complete the file, and return how it went. A second time does nothing.

        Raises:
            RecordingError: the file is not complete: the disk is full, or has hung for `timeout` seconds.
                What was written can be read.
        """
        if not self._thread.ident:
            self.start()
        self._ended.set()
        self._thread.join(timeout)
        if self._thread.is_alive():
            raise RecordingError(
                f"has not taken what was recorded for {timeout:g} s",
                where=str(self._writer.path),
                remedy="See what the disk does; the file can be mended.",
            )
        if self._is_failing:
            raise RecordingError(f"is not complete: {self._error}", where=str(self._writer.path))
        return self.totals

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # ------------------------------------------------------------------------------- its own thread

    def _run(self) -> None:
        is_over = False
        while not is_over:
            is_over = self._ended.wait(self._period)
            self._attempt(self._write)
        self._attempt(self._finish)

    def _attempt(self, step: Callable[[], None]) -> None:
        """Do a step; what goes wrong is told once, and again when it goes right."""
        try:
            step()
        except Exception as error:
            self._error = str(error) if isinstance(error, RecordingError) else unexpected(error)
            if not self._is_failing:
                logger.error("recording: %s", self._error)
            self._is_failing = True
        else:
            if self._is_failing:
                logger.warning("recording goes on; %d values are lost", self.totals.lost)
            self._is_failing = False

    def _write(self) -> None:
        failure: RecordingError | None = None
        for _ in range(len(self._queue)):
            number, topic, value, stamp_ns, log_time = self._queue.popleft()
            self._newest = max(self._newest, number)
            self._drained += 1
            message = self._encoded(topic, value, stamp_ns)
            if message is None:
                continue
            type_name, data = message
            try:
                channel = self._channel(topic, type_name)
            except RecordingError as error:
                self._refused += 1
                failure = error
                continue
            self._added += 1
            try:
                self._writer.message(channel, data, log_time, stamp_ns or log_time)
            except RecordingError as error:  # of those before: this one is kept
                failure = error
        self._writer.flush()
        if failure is not None:
            raise failure

    def _encoded(
        self, topic: str, value: Value | Status, stamp_ns: int
    ) -> tuple[str, bytes] | None:
        """Return the type of a value and its message; None, told once a topic, if it cannot be recorded."""
        type_name = cdr.TYPE_NAMES.get(type(value), "")
        known, _ = self._channels.get(topic, (type_name, 0))
        try:
            if not type_name:
                raise RecordingError(f"a {type(value).__name__} cannot be recorded")
            if known != type_name:
                raise RecordingError(f"it is a {type_name}, not a {known} as before")
            frame_id = getattr(value, "frame_id", "") or self._frame_id
            return type_name, cdr.encode(value, stamp_ns, frame_id)
        except Exception as error:
            if not self._unsuited[topic]:
                logger.warning("recording: %s is left out: %s", topic, error)
            self._unsuited[topic] += 1
            return None

    def _channel(self, topic: str, type_name: str) -> int:
        known = self._channels.get(topic)
        if known is None:
            known = self._channels[topic] = type_name, self._writer.channel(topic, type_name)
        return known[1]

    def _finish(self) -> None:
        totals = self.totals
        try:
            texts = {key: str(value) for key, value in asdict(totals).items() if value != ""}
            self._writer.metadata(TOTALS, texts)
        finally:
            self._writer.finish()


def _begun(
    path: str | Path, metadata: Mapping[str, Mapping[str, str]], attachments: Mapping[str, bytes]
) -> McapWriter:
    writer = McapWriter(path)
    try:
        for name, texts in metadata.items():
            writer.metadata(name, texts)
        for name, data in attachments.items():
            writer.attachment(name, data)
    except RecordingError:
        with suppress(RecordingError):
            writer.finish()
        raise
    return writer
