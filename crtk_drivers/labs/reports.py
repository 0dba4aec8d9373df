"""What a device that runs in a lab tells whoever started it: one JSON object a line, over a pipe."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from crtk_drivers.state import Status
from crtk_drivers.status.health import Health
from crtk_drivers.status.pulse import Pulse

REPORT_FD: Final = "CRTK_DRIVERS_REPORT_FD"
"""Environment variable: the descriptor of the pipe that a device writes to."""

PULSE_FD: Final = "CRTK_DRIVERS_PULSE_FD"
"""Environment variable: the descriptor by which a device and whoever started it hear each other."""

STANDS_STILL: Final = 10.0
"""Seconds without a sign of life after which whoever started a device counts as gone."""

PERIOD: Final = 0.5
"""Seconds between two reports at most."""

FRESH: Final = 1.0
"""Seconds that the newest sample of a device that measures may be old."""

LONGEST: Final = 200
"""Characters of a text: a report is no longer than what a pipe takes as a whole or not at all (PIPE_BUF)."""

_SIZE: Final = 65536


@dataclass(frozen=True, slots=True)
class Report:
    """How a device is.

    Attributes:
        state: operating state.
        cause: of it, in words.
        is_busy, is_homed: as in the operating state.
        measures: it is connected, and has measured lately.
        rate, expected: cycles a second.
        late: cycles that were late so far.
        refused: commands that were refused so far.
        last_refusal: in words.
    """

    state: str
    cause: str
    is_busy: bool
    is_homed: bool
    measures: bool
    rate: float
    expected: float
    late: int
    refused: int
    last_refusal: str

    @classmethod
    def of(cls, status: Status, health: Health) -> Report:
        """Return the report of a status with its counters."""
        return cls(
            state=str(status.state),
            cause=shortened(status.cause),
            is_busy=status.is_busy,
            is_homed=status.is_homed,
            measures=health.connected and health.sample_age < FRESH,
            rate=round(health.rate, 1),
            expected=health.rate_expected,
            late=health.late_cycles,
            refused=sum(health.refusals.values()),
            last_refusal=shortened(health.last_refusal),
        )


def shortened(text: str) -> str:
    """Return a text of at most `LONGEST` characters."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


def line_of(values: Mapping[str, Any]) -> bytes:
    """Return values as a line for a pipe, with letters of four bytes at most: escaped, some have twelve.

    Half of a pair, which no UTF-8 has, is escaped as JSON escapes it.
    """
    text = json.dumps(values, ensure_ascii=False)
    return text.encode(errors="backslashreplace") + b"\n"


def whoever_started() -> tuple[int, Pulse | None] | None:
    """Return the pipe to a lab that started this process, and its pulse; None if none did. Once only."""
    descriptor, end = (os.environ.pop(name, "") for name in (REPORT_FD, PULSE_FD))
    if not descriptor:
        return None
    return int(descriptor), Pulse.start(socket.socket(fileno=int(end))) if end else None


class LinePipe:
    """Writes lines into a pipe, each as a whole or not at all, and never waits.

    Args:
        descriptor: of the pipe; it is closed at the end of this process.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        os.set_inheritable(descriptor, False)
        os.set_blocking(descriptor, False)

    def put(self, line: bytes) -> bool:
        """Write a line; return False if the reader is busy: the next one will do.

        Raises:
            BrokenPipeError: nobody reads any more.
        """
        try:
            os.write(self._descriptor, line)
        except BlockingIOError:
            return False
        return True


class Reporter:
    """Writes reports. `update` may be called as often as one likes; it never waits.

    Args:
        descriptor: of the pipe; it is closed at the end of this process.
        read: returns status and health.
        clock: monotonic seconds.
        pulse: of whoever reads; None: it is not listened for.
    """

    def __init__(
        self,
        descriptor: int,
        read: Callable[[], tuple[Status, Health]],
        clock: Callable[[], float],
        pulse: Pulse | None = None,
    ) -> None:
        self._pipe = LinePipe(descriptor)
        self._pulse = pulse
        self._read = read
        self._clock = clock
        self._due = 0.0
        self._told = ""

    def update(self) -> bool:
        """Write a report if it is time, or the state is another; return whether somebody still reads."""
        if self._pulse is not None and self._pulse.silence() > STANDS_STILL:
            return False
        status, health = self._read()
        now = self._clock()
        if now < self._due and str(status.state) == self._told:
            return True
        line = line_of(asdict(Report.of(status, health)))
        try:
            if not self._pipe.put(line):
                return True
        except BrokenPipeError:
            return False
        self._due, self._told = now + PERIOD, str(status.state)
        return True


def read_reports(descriptor: int, rest: bytes) -> tuple[list[Report], bytes]:
    """Return the reports that have come, and what has come of the next one; see `read_objects`."""
    found, rest = read_objects(descriptor, rest)
    return [Report(**each) for each in found], rest


def read_objects(descriptor: int, rest: bytes) -> tuple[list[dict[str, Any]], bytes]:
    """Return the JSON objects that have come, one a line, and what has come of the next one.

    Args:
        descriptor: of a pipe, which does not block.
        rest: what had come before of the next line.
    """
    data = rest
    try:
        while part := os.read(descriptor, _SIZE):
            data += part
    except BlockingIOError:
        pass
    *lines, rest = data.split(b"\n")
    return [json.loads(line) for line in lines], rest


def last_line(log: Path) -> str:
    """Return the last line that a process has written into its log; empty if there is none.

    A hint is passed over: the error stands before it, and says what is wrong.
    """
    with contextlib.suppress(OSError):
        text = log.read_bytes()[-4096:].decode(errors="replace").strip()
        lines = [line.strip() for line in text.splitlines()]
        said = [line for line in lines if line and not line.startswith("hint:")] or lines
        return said[-1] if said else ""
    return ""
