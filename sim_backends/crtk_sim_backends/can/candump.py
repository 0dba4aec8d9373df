"""Logs in the format of ``candump -l``, as can-utils and python-can read and write them.

One frame a line, ``(1436509052.249713) can0 123#DEADBEEF``: seconds since 1970, interface,
identifier of 3 (standard) or 8 digits (extended, error), data; ``123#R`` or ``123#R4`` is a remote
frame. Source: can-utils, lib.c (`sprint_canframe`) and candump.c.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from crtk_sim_backends.can import frames

_FRAME: Final = re.compile(
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:R(?P<length>[0-8])?|(?P<data>(?:[0-9A-Fa-f]{2}){0,8}))"
)
_LINE: Final = re.compile(
    r"\((?P<time>\d{1,12}\.\d{1,9})\)\s+(?P<channel>\S+)\s+(?P<frame>\S+)(?:\s+[RTrt])?"
)


class LogError(ValueError):
    """A log that cannot be read or written."""


class Record(NamedTuple):
    """One line of a log."""

    time: float  # s since 1970
    channel: str
    raw: bytes


def text(raw: bytes) -> str:
    """Return a frame as ``123#DEADBEEF``."""
    can_id, data = frames.unpack(raw)
    if can_id & frames.ERROR:
        number = f"{can_id & (frames.ERROR | frames.EXTENDED_MASK):08X}"
    elif can_id & frames.EXTENDED:
        number = f"{can_id & frames.EXTENDED_MASK:08X}"
    else:
        number = f"{can_id & frames.STANDARD_MASK:03X}"
    if can_id & frames.REMOTE:
        return f"{number}#R{len(data) or ''}"
    return f"{number}#{data.hex().upper()}"


def parse_frame(frame: str) -> bytes:
    """Read a frame such as ``123#DEADBEEF``.

    Raises:
        LogError: with what was expected.
    """
    match = _FRAME.fullmatch(frame)
    if match is None:
        raise LogError(f"expected a frame such as 123#DEADBEEF, not {frame!r:.80}")
    digits = match["id"]
    can_id = int(digits, 16)
    if can_id & ~(frames.ERROR | frames.EXTENDED_MASK):
        raise LogError(f"there is no identifier {digits}")
    if len(digits) == 8 and not can_id & frames.ERROR:
        can_id |= frames.EXTENDED
    elif len(digits) == 3 and can_id > frames.STANDARD_MASK:
        raise LogError(f"identifier {digits} needs 8 digits")
    if match["data"] is None:
        return frames.pack(can_id | frames.REMOTE, b"", int(match["length"] or 0))
    return frames.pack(can_id, bytes.fromhex(match["data"]))


def parse(line: str) -> Record:
    """Read one line.

    Raises:
        LogError: with what was expected.
    """
    match = _LINE.fullmatch(line.strip())
    if match is None:
        raise LogError(f"expected '(seconds.fraction) interface id#data', not {line.strip()!r:.80}")
    return Record(float(match["time"]), match["channel"], parse_frame(match["frame"]))


def read(path: Path) -> Iterator[Record]:
    """Read a log, line by line; empty lines are passed over.

    Raises:
        LogError: with the file and line of what is wrong, or when it cannot be read.
    """
    try:
        with path.open(encoding="ascii") as file:
            for number, line in enumerate(file, 1):
                if line.strip():
                    try:
                        yield parse(line)
                    except LogError as error:
                        raise LogError(f"{path}, line {number}: {error}") from error
    except OSError as error:
        raise LogError(f"cannot read the log {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LogError(f"{path} is no log: {error}") from error


class LogWriter:
    """Writes a log; `close` it.

    Raises:
        LogError: when the file cannot be created.
    """

    def __init__(self, path: Path, channel: str = "can0") -> None:
        self._channel = channel
        try:
            self._file = path.open("w", encoding="ascii", buffering=1 << 16)
        except OSError as error:
            raise LogError(f"cannot write the log {path}: {error.strerror}") from error

    def write(self, at: float, raw: bytes) -> None:
        """Add a frame that was received at `at` (s since 1970)."""
        self._file.write(f"({at:.6f}) {self._channel} {text(raw)}\n")

    def flush(self) -> None:
        """Hand what is written to the system."""
        self._file.flush()

    def close(self) -> None:
        """Write the rest; safe to repeat."""
        self._file.close()
