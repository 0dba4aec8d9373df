"""Every sample of a device under test, and what was asked of it, in the order of arrival, as MCAP.

Topics are ``measured_js`` and others of the device, ``<child>/measured_cp`` and so on of the devices behind
it, ``command/<name>`` for what it was asked, and ``events``: JSON with what happened, marks and notes of the
test among it. A second device that is recorded, which carries the first one, has a file of its own beside it,
whose topics are read as ``carrier/measured_js`` and so on.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from operator import itemgetter
from pathlib import Path
from typing import Final

from crtk_drivers.engine import Engine
from crtk_drivers.errors import RecordingError
from crtk_drivers.labs.bench.trace import Row
from crtk_drivers.recording import Recorder, Recording
from crtk_drivers.samples import Number, Stamp, Text, Value

RECORDED: Final = (
    *("measured_js", "setpoint_js", "measured_cp", "measured_cv"),
    *("measured_cf", "raw/measured_cf"),
)

EVENTS: Final = "events"


class SampleRecorder:
    """What takes samples belongs to the I/O thread and waits for nobody; the rest is for any thread.

    Args:
        engine: of the device.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._recorder: Recorder | None = None
        self._lock = threading.Lock()

    def begin(self, path: str) -> None:
        """Record into a new file from now on.

        Raises:
            RecordingError: it cannot be made.
        """
        recorder = Recorder(path, metadata={"device": {"name": self._engine.where}})
        recorder.start()
        with self._lock:
            self._recorder = recorder

    def end(self) -> None:
        """Write what is left and record no more. May be called twice.

        Raises:
            RecordingError: the file is not complete.
        """
        with self._lock:
            recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        totals = recorder.close()
        if totals.lost:
            raise RecordingError(f"the recording lacks {totals.lost} values: {totals.error}")

    def taker(self, engine: Engine, prefix: str = "") -> Callable[[], None]:
        """Return what takes that which an engine tells now: that of the device, or of one behind it.

        Args:
            engine: whose it is.
            prefix: before its topics.
        """
        names = tuple(name for name in RECORDED if name in engine.commands)

        def take() -> None:
            recorder = self._recorder
            if recorder is None:
                return
            for name in names:
                found = engine.feedback(name)
                if found is not None:
                    recorder.take(f"{prefix}{name}", *found)

        return take

    def command(self, name: str, value: Value | None, stamp_ns: int) -> None:
        """Take what was asked of the device."""
        recorder = self._recorder
        if recorder is not None:
            stamp = Stamp(stamp_ns, time.monotonic())
            recorder.take(f"command/{name}", _recordable(value), stamp)

    def event(self, kind: str, text: str) -> None:
        """Take what happened: a change of state, a refusal, a mark of a test."""
        recorder = self._recorder
        if recorder is not None:
            recorder.take(EVENTS, Text(json.dumps({"kind": kind, "text": text})), Stamp.now())


def _recordable(value: Value | None) -> Value:
    """Return a value as it can be in a recording: a number, or none at all, as text."""
    if value is None:
        return Text("")
    return Text(f"{value.value:g}") if isinstance(value, Number) else value


def carrier_recording(path: Path) -> Path:
    """Return where the device that carries another one is recorded, beside the recording of that."""
    return path.with_suffix(".carrier.mcap")


def read_recording(path: Path) -> list[Row]:
    """Return the rows of a recording, finished or cut off, and of the one beside it if there is one.

    Raises:
        RecordingError: there is none, or it is broken.
    """
    rows = _rows(path)
    beside = carrier_recording(path)
    if not beside.exists():
        return rows
    carrier = [(f"carrier/{topic}", *rest) for topic, *rest in _rows(beside)]
    return sorted([*rows, *carrier], key=itemgetter(1))


def _rows(path: Path) -> list[Row]:
    rows: list[Row] = []
    for message in Recording(path).messages():
        found = message.decoded()
        rows.append((message.topic, message.log_time, found.stamp_ns, found.value))
    return rows
