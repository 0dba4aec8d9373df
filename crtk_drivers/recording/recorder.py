"""Takes messages from threads that must not wait, and writes them in a thread of its own.

Whoever hands something over never waits for a disk: it lies in a queue. When that is full, what comes is
dropped until there is room: what came before is whole. What is lost is counted, told, and written into the
recording. A disk that is full ends neither the recording nor the device: it is told, and tried again with
what comes next.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self

from crtk_drivers.errors import RecordingError, unexpected
from crtk_drivers.recording import cdr
from crtk_drivers.recording.series import ONE_FILE, Raw, Series, Split
from crtk_drivers.samples import Stamp, Value
from crtk_drivers.state import Status
from crtk_drivers.status.real_time import ask_for_real_time

__all__ = ["Entry", "Recorder", "Totals"]

PERIOD: Final = 0.03
"""Seconds between two writes: with the time for one, no more than 50 ms are lost if the process is killed."""

PRIORITY: Final = 1
"""Real-time, below the I/O threads: they wait for the lock of Python, and so for whoever has it to be run."""

CAPACITY: Final = 30_000
"""Entries that wait at most: a minute of samples at 500 Hz, ten seconds of six topics."""

CAPACITY_SIZE: Final = 256_000_000
"""Bytes that wait at most, of messages that were made elsewhere: images, point clouds."""

CLOSE_TIMEOUT: Final = 10.0
"""Seconds in which what waits must have been written at the end."""

TOTALS: Final = "crtk_drivers recording"
"""Name of the metadata that a recording ends with: `Totals`."""

logger = logging.getLogger(__name__)

Entry = tuple[Any, ...]
"""A function that returns messages, what they are of, their log time, and its other arguments.

It is called in the thread that writes.
"""


@dataclass(frozen=True, slots=True)
class Totals:
    """How a recording went.

    Attributes:
        taken: messages that were handed over; what waits is not counted yet.
        written: of these, in the file.
        lost: of these, not in it: the queue or the disk was full.
        unsuited: of these, not in it: no message can hold them.
        size: bytes in all files.
        files: how many.
        error: what went wrong last; empty if nothing did.
    """

    taken: int
    written: int
    lost: int
    unsuited: int
    size: int
    files: int
    error: str


class Recorder:
    """Records what it is given, from `start` to `close`.

    Args:
        path: of the file, which is made here.
        metadata: texts by name, by name; written first.
        attachments: files that go with it, by name.
        frame_id: of values that do not name their own.
        period: seconds between two writes.
        capacity: entries that wait at most.
        split: when the next file begins.
        keep_free: bytes of its disk that messages leave to others; 0: none.
        before_write: called in its thread before each write; what it takes is written too.

    Attributes:
        series: the files.

    Raises:
        RecordingError: the file cannot be made.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        metadata: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
        attachments: Mapping[str, bytes] = MappingProxyType({}),
        frame_id: str = "",
        period: float = PERIOD,
        capacity: int = CAPACITY,
        split: Split = ONE_FILE,
        keep_free: int = 0,
        before_write: Callable[[], None] = lambda: None,
    ) -> None:
        self.series = Series(path, metadata, attachments, split, keep_free)
        self._frame_id = frame_id
        self._period = period
        self._capacity = capacity
        self._before_write = before_write
        self._queue: deque[tuple[int, int, Entry]] = deque()
        self._held = 0
        self._to_hold: deque[tuple[str, str, Mapping[str, str], bool]] = deque()
        self._counting = threading.Lock()
        self._dropped = 0
        self._drained = 0
        self._types: dict[str, str] = {}
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
        self.put((self._of_value, topic, time.time_ns(), value, stamp.wall_ns))

    def put(self, entry: Entry, messages: int = 1, size: int = 0) -> None:
        """Record what an entry makes, later. Never waits, never raises; from any thread.

        Args:
            entry: see `Entry`; its function may raise.
            messages: how many it makes: so many are lost if there is no room.
            size: bytes that it holds; 0: it holds what others hold too, or little.
        """
        if len(self._queue) < self._capacity and self._held + size <= CAPACITY_SIZE:
            if size:
                with self._counting:
                    self._held += size
            self._queue.append((messages, size, entry))
            return
        with self._counting:
            self._dropped += messages

    def hold(self, key: str, name: str, texts: Mapping[str, str], at_once: bool = False) -> None:
        """Write metadata, see `Series.hold`. Never waits, never raises; from any thread."""
        self._to_hold.append((key, name, texts, at_once))

    @property
    def totals(self) -> Totals:
        """How it goes. What waits to be written is no loss."""
        series, dropped = self.series, self._dropped
        lost = dropped + self._refused + series.lost
        written, unsuited = self._added - series.lost, self._unsuited.total()
        return Totals(
            self._drained + dropped,
            written,
            lost,
            unsuited,
            series.size,
            len(series.paths),
            self._error,
        )

    def close(self, timeout: float = CLOSE_TIMEOUT) -> Totals:
        """Write what waits, complete the file, and return how it went. A second time does nothing.

        Raises:
            RecordingError: the file is not complete: the disk is full, or has hung for `timeout` seconds.
                What was written can be read.
        """
        where = str(self.series.paths[-1])
        if not self._thread.ident:
            self.start()
        self._ended.set()
        self._thread.join(timeout)
        if self._thread.is_alive():
            raise RecordingError(
                f"has not taken what was recorded for {timeout:g} s",
                where=where,
                remedy="See what the disk does; the file can be mended.",
            )
        if self._is_failing:
            raise RecordingError(f"is not complete: {self._error}", where=where)
        return self.totals

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # ------------------------------------------------------------------------------- its own thread

    def _run(self) -> None:
        ask_for_real_time(PRIORITY)
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
                logger.warning("recording goes on; %d messages are lost", self.totals.lost)
            self._is_failing = False

    def _write(self) -> None:
        failure: Exception | None = None
        try:
            self._before_write()
        except Exception as error:  # what has come is written all the same
            failure = error
        for _ in range(len(self._queue)):
            messages, size, entry = self._queue.popleft()
            self._drained += messages
            if size:
                with self._counting:
                    self._held -= size
            for raw in self._made(messages, entry):
                failure = self._add(raw) or failure
        while self._to_hold:
            try:
                self.series.hold(*self._to_hold.popleft())
            except RecordingError as error:  # the messages are written all the same
                failure = error
        self.series.flush()
        if failure is not None:
            raise failure

    def _made(self, messages: int, entry: Entry) -> Iterable[Raw]:
        """Return the messages of an entry; none, told once of a kind, if it fails."""
        make, *arguments = entry
        try:
            made = tuple(make(*arguments))
        except Exception as error:
            why = str(error) if isinstance(error, RecordingError) else unexpected(error)
            self._leave_out(str(arguments[0]), why, messages)
            return ()
        self._drained += len(made) - messages
        return made

    def _add(self, raw: Raw) -> RecordingError | None:
        known = self._types.setdefault(raw.topic, raw.type_name)
        if known != raw.type_name:
            self._leave_out(raw.topic, f"it is a {raw.type_name}, not a {known} as before")
            return None
        try:
            self.series.channel(raw)
        except RecordingError as error:
            self._refused += 1
            return error
        self._added += 1
        try:
            self.series.message(raw)
        except RecordingError as error:  # of those before: this one is kept
            return error
        return None

    def _leave_out(self, what: str, why: str, messages: int = 1) -> None:
        if not self._unsuited[what]:
            logger.warning("recording: %s is left out: %s", what, why)
        self._unsuited[what] += messages

    def _of_value(
        self, topic: str, log_time: int, value: Value | Status, stamp_ns: int
    ) -> Iterable[Raw]:
        type_name = cdr.TYPE_NAMES.get(type(value))
        if type_name is None:
            raise RecordingError(f"a {type(value).__name__} cannot be recorded")
        frame_id = getattr(value, "frame_id", "") or self._frame_id
        data = cdr.encode(value, stamp_ns, frame_id)
        return (Raw(topic, type_name, data, log_time, stamp_ns or log_time),)

    def _finish(self) -> None:
        texts = {key: str(value) for key, value in asdict(self.totals).items() if value != ""}
        self.series.finish({TOTALS: texts})
