"""Every sample of a device under test, and what was asked of it, in the order of arrival."""

from __future__ import annotations

import json
import logging
import pickle
import threading
import time
from pathlib import Path
from typing import Any, Final

from crtk_drivers.engine import Engine
from crtk_drivers.labs.bench.trace import Row
from crtk_drivers.samples import Value

__all__ = ["SampleRecorder", "read_recording"]

RECORDED: Final = ("measured_js", "setpoint_js", "measured_cp", "measured_cv", "measured_cf")

logger = logging.getLogger(__name__)


class SampleRecorder:
    """`sample` belongs to the I/O thread and waits for nobody; the rest may be called from any thread.

    Args:
        engine: of the device.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._names = tuple(name for name in RECORDED if name in engine.commands)
        self._rows: list[tuple[str, int, int, Any]] | None = None
        self._path: Path | None = None
        self._lock = threading.Lock()

    def begin(self, path: str) -> None:
        """Record into a new file from now on."""
        with self._lock:
            self._path, self._rows = Path(path), []

    def end(self) -> None:
        """Write what was recorded and record no more. May be called twice."""
        with self._lock:
            rows, self._rows = self._rows, None
            if rows is None or self._path is None:
                return
            self._path.write_bytes(pickle.dumps(rows))

    def sample(self) -> None:
        """Take what is told now."""
        rows = self._rows
        if rows is None:
            return
        now = time.time_ns()
        for name in self._names:
            found = self._engine.feedback(name)
            if found is not None:
                value, stamp = found
                rows.append((name, now, stamp.wall_ns, value))

    def command(self, name: str, value: Value | None, stamp_ns: int) -> None:
        """Take what was asked of the device."""
        rows = self._rows
        if rows is not None:
            rows.append((f"command/{name}", time.time_ns(), stamp_ns, value))

    def event(self, kind: str, text: str) -> None:
        """Take what happened: a change of state, a refusal, a mark of a test."""
        rows = self._rows
        if rows is not None:
            now = time.time_ns()
            rows.append(("events", now, now, json.dumps({"kind": kind, "text": text})))


def read_recording(path: Path) -> list[Row]:
    """Return the rows of a recording.

    Raises:
        LookupError: there is none.
    """
    try:
        found: list[Row] = pickle.loads(path.read_bytes())
    except OSError as error:
        raise LookupError(f"{path.name}: {error.strerror}") from error
    return found
