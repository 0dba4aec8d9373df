"""The last seconds of a device in memory, written to a file when it faults, or when somebody asks.

The I/O thread adds one reference a cycle to a ring; nothing is converted before a file is written, and then
in a thread that lets others run between two parts of it.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from operator import itemgetter
from pathlib import Path
from typing import Final

from typing_extensions import override

from crtk_drivers.engine import Observer
from crtk_drivers.errors import CrtkError, RecordingError, unexpected
from crtk_drivers.motion.past import Moment
from crtk_drivers.recording import Raw, Series
from crtk_drivers.recording.recorder import PRIORITY, Entry
from crtk_drivers.samples import Stamp
from crtk_drivers.session.tape import Tape, is_new_fault
from crtk_drivers.state import Status
from crtk_drivers.status.real_time import ask_for_real_time

AFTER: Final = 0.5
"""Seconds after a fault that are in its file."""
SPARE: Final = 5.0
"""Seconds between two files for faults: one that comes again and again fills no disk."""
PART: Final = 50
"""Entries that are written before others may run."""
PAUSE: Final = 0.004
"""Seconds in which they may."""
FORGETS: Final = 1.0
"""Seconds after which it is looked for events that are too old."""
LEAST: Final = 256
"""Events that are kept at least."""
MOST_LARGE: Final = 8
"""Of those that hold much: whoever sends them fills no memory."""

logger = logging.getLogger(__name__)


class _Ring:
    """The last seconds of one tape, by the monotonic clock: the time of day may leap."""

    def __init__(self, tape: Tape, rate: float, seconds: float) -> None:
        self.tape = tape
        self._tell = tape.teller()
        self.moments: deque[tuple[float, Moment]] = deque(maxlen=max(1, round(seconds * rate)))
        self._events: deque[tuple[float, Entry]] = deque(maxlen=max(LEAST, round(seconds * rate)))
        self._large: deque[tuple[float, Entry]] = deque(maxlen=MOST_LARGE)
        self._seconds = seconds

    def begin(self) -> None:
        self.tape.attach(self._keep, self._add)

    def end(self) -> None:
        self.tape.detach(self._keep, self._add)

    def _keep(self, moment: Moment) -> None:
        self.moments.append((time.monotonic(), moment))

    def _add(self, entry: Entry, messages: int, size: int = 0) -> None:
        (self._large if size else self._events).append((time.monotonic(), entry))

    def forget(self) -> None:
        """Let go of events that are older: a device that is quiet would keep them for ever."""
        begun = time.monotonic() - self._seconds
        for events in (self._events, self._large):
            with suppress(IndexError):
                while events[0][0] < begun:
                    events.popleft()

    def entries(self) -> list[Entry]:
        """Return all that is in it, in the order of time."""
        begun = time.monotonic() - self._seconds
        kept: list[tuple[float, Entry]] = [
            (at, (self._tell, "samples", moment[0], moment)) for at, moment in [*self.moments]
        ]
        kept += [*self._events, *self._large]
        kept.sort(key=itemgetter(0))
        return [entry for at, entry in kept if at >= begun]


class BlackBox(Observer):
    """Keeps the last seconds of a device and those behind it, and writes them.

    Args:
        tapes: with the rate of each; the first is that of the device.
        seconds: that are kept.
        path: returns where the next file goes, by the reason; makes room there.
        about: returns metadata and attachments of a file.
    """

    def __init__(
        self,
        tapes: Iterable[tuple[Tape, float]],
        seconds: float,
        path: Callable[[], Path],
        about: Callable[[str], tuple[Mapping[str, Mapping[str, str]], Mapping[str, bytes]]],
    ) -> None:
        self._rings = [_Ring(tape, rate, seconds) for tape, rate in tapes]
        self._path = path
        self._about = about
        self._status = Status()
        self._fault = ""
        self._came = threading.Event()
        self._ended = threading.Event()
        self._writing = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="black box", daemon=True)

    def start(self) -> None:
        """Keep from now on."""
        for ring in self._rings:
            ring.begin()
        self._thread.start()

    def close(self, timeout: float = 5.0) -> None:
        """Keep no more; a fault that was not written yet is written. May be called twice."""
        if not self._thread.ident or self._ended.is_set():
            return
        for ring in self._rings:
            ring.end()
        self._ended.set()
        self._came.set()
        self._thread.join(timeout)

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        before, self._status = self._status, status
        if is_new_fault(before, status) and not self._came.is_set():
            self._fault = status.detail or "FAULT"
            self._came.set()

    def dump(self, reason: str, path: Path | None = None) -> Path:
        """Write what is kept now, and return the file. From any thread.

        Raises:
            RecordingError: it cannot be written, or there is nothing.
        """
        written = self._dump(reason, path)
        if written is None:
            raise RecordingError(
                "there is nothing to be written: no sample has come",
                remedy="Connect the device first.",
            )
        return written

    def _dump(self, reason: str, path: Path | None = None) -> Path | None:
        """Write what is kept now, and return the file; None if no sample has come.

        Raises:
            RecordingError: it cannot be written.
        """
        with self._writing:
            for ring in self._rings:
                ring.tape.look()
            entries = [entry for ring in self._rings for entry in ring.entries()]
            if not any(ring.moments for ring in self._rings):
                return None
            path = path or self._path()
            metadata, attachments = self._about(reason)
            series = Series(path, metadata, attachments)
            try:
                for ring in self._rings:
                    for raw in ring.tape.standing():
                        series.message(raw)
                self._write(series, entries)
            finally:
                series.finish()
        return path

    def _write(self, series: Series, entries: list[Entry]) -> None:
        left_out: set[str] = set()
        for number, (make, *arguments) in enumerate(entries):
            try:
                made: tuple[Raw, ...] = tuple(make(*arguments))
            except Exception as error:
                what = str(arguments[0])
                if what not in left_out:
                    logger.warning("black box: %s is left out: %s", what, unexpected(error))
                left_out.add(what)
                continue
            for raw in made:
                series.message(raw)
            if number % PART == PART - 1:
                series.flush()
                time.sleep(PAUSE)

    def _run(self) -> None:
        ask_for_real_time(PRIORITY)
        while not self._ended.is_set():
            self._came.wait(FORGETS)
            for ring in self._rings:
                ring.forget()
            if not self._fault:
                continue
            self._ended.wait(AFTER)
            self._tell(self._fault)
            self._fault = ""
            self._ended.wait(SPARE)
            if not self._ended.is_set():
                self._came.clear()
        if self._fault:  # it came while this thread was looking whether it is to end
            self._tell(self._fault)

    def _tell(self, reason: str) -> None:
        try:
            path = self._dump(reason)
        except CrtkError as error:
            logger.warning("black box: %s", error)
        except Exception as error:
            logger.exception("black box: %s", unexpected(error))
        else:
            if path is None:  # it was never connected, which has been said
                return
            logger.warning("black box: what led to this is in %s", path)
