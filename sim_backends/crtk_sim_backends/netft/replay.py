"""Loads that were recorded: from a CSV file, from a recording of the driver, or from captured RDT traffic.

    replay:file=press.csv                                  time, fx, fy, fz, tx, ty, tz
    replay:file=press.ftrec,speed=0.5,loop=no              half as fast, and the last load stays
    replay:file=press.pcapng,counts_per_force=1000000,counts_per_torque=1000000

What kind of file it is its first bytes say. Between two measurements the load goes straight from one to the
other. Only the load is replayed: status bits, losses and rates are those of the simulated box.

Time. A CSV file says it in s, from wherever, never backwards. Recordings and captures are paced by the
sensor's own counter of measurements, which has none of the network's delays; their stamps only say how long
one count is, and where a pause or a restart lies.
"""

from __future__ import annotations

import io
import json
import logging
import math
import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crtk_sim_backends.kit.loads import Array, LoadError
from crtk_sim_backends.netft.pcap import Capture, CaptureError, is_capture

LARGEST_FILE: Final = 1 << 29
"""Bytes."""
MOST: Final = 4_000_000
"""Measurements: more than nine minutes of a sensor at 7 kHz."""
LONGEST_HEADER: Final = 1 << 20
"""Bytes of the first line of a recording."""
PAUSE: Final = 0.25
"""Seconds by which stamps and counter may disagree before the counter is taken to have begun anew."""
LONGEST_LINE: Final = 1 << 16
"""Bytes of a line of a CSV file."""
FURTHEST: Final = 100_000
FURTHEST_APART: Final = 1.0
"""Counts, and seconds, between two records from which the length of a count is taken."""
RECORD: Final = 36
"""Bytes of an RDT record (ATI 9620-05-NET FT, RDT)."""
RDT_PORT: Final = 49152

logger = logging.getLogger(__name__)


class Track(NamedTuple):
    """Loads over time.

    Attributes:
        times: in s, ascending, from 0 (n,).
        values: N and N·m (n, 6).
    """

    times: Array
    values: Array


@dataclass(frozen=True)
class Replay:
    """A recorded load.

    `speed` scales the pace (2.0: twice as fast). With `loop` it begins anew at the end, otherwise its last
    value stays. The rest is for captures, which do not say it: counts per N and per N·m, the port that the
    sensor sends from, and its address, needed where several sensors are in one capture.

    Raises:
        LoadError: from the constructor; says which file, and where in it.
    """

    file: str
    speed: float = 1.0
    loop: bool = True
    counts_per_force: float = 1e6
    counts_per_torque: float = 1e6
    port: int = RDT_PORT
    source: str = ""
    _track: Track = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("speed", "counts_per_force", "counts_per_torque"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise LoadError(f"{name} must be above 0, not {getattr(self, name)}")
        object.__setattr__(self, "_track", self._read())

    @property
    def duration(self) -> float:
        """Seconds of it, at its own pace, the step from its end to its beginning included."""
        times = self._track.times
        return float(times[-1] * times.size / (times.size - 1)) if times.size > 1 else 0.0

    def wrench(self, t: Array) -> Array:
        """See `Load`."""
        position = t * self.speed
        if self.loop and self.duration:
            position = position % self.duration
        times, values = self._track
        return np.stack([np.interp(position, times, axis) for axis in values.T], axis=1)

    def _read(self) -> Track:
        path = Path(self.file)
        if path.exists() and not path.is_file():
            raise LoadError(f"{path}: is no file")
        try:
            size = path.stat().st_size
            if size > LARGEST_FILE:
                raise LoadError(f"{path}: {size} bytes; {LARGEST_FILE} can be replayed")
            content = path.read_bytes()
        except OSError as error:
            raise LoadError(f"{path}: {error.strerror}") from error
        try:
            track = self._reader(content[:4])(content)
        except (CaptureError, LoadError) as error:
            raise LoadError(f"{path}: {error}") from error
        if not track.times.size:
            raise LoadError(f"{path}: holds no measurements")
        return track

    def _reader(self, beginning: bytes) -> Callable[[bytes], Track]:
        if is_capture(beginning):
            return self._read_capture
        return _read_recording if beginning[:1] == b"{" else _read_csv

    def _read_capture(self, content: bytes) -> Track:
        capture = Capture(content)
        arrivals: list[float] = []
        parts: list[bytes] = []
        sources: dict[str, None] = {}
        for datagram in capture:
            payload = datagram.payload
            if datagram.source_port != self.port or not payload or len(payload) % RECORD:
                continue
            if self.source and datagram.source != self.source:
                continue
            sources[datagram.source] = None
            if len(sources) > 1:
                found = " and ".join(sources)
                raise LoadError(f"offset {datagram.offset}: {found} both send; give source=")
            arrivals += [datagram.time] * (len(payload) // RECORD)
            if len(arrivals) > MOST:
                raise LoadError(f"offset {datagram.offset}: more than {MOST} measurements")
            parts.append(payload)
        if capture.cut:
            logger.warning("%s: ends in the middle of a packet, which is left out", self.file)
        if not arrivals:
            sender = f"port {self.port}" + (f" of {self.source}" if self.source else "")
            raise LoadError(f"no RDT records from {sender} over UDP and IPv4 in it")
        words = np.frombuffer(b"".join(parts), ">i4").reshape(-1, 9)
        counts = np.repeat((self.counts_per_force, self.counts_per_torque), 3)
        ticks = words[:, 1].astype(np.int32)
        return _paced(ticks, np.array(arrivals), words[:, 3:] / counts)


# ---------------------------------------------------------------------------------------------------- time


def _paced(ticks: NDArray[np.int32], stamps: Array, values: Array) -> Track:
    """Return a track with the pace of the sensor's counter.

    Args:
        ticks: the counter, which may wrap, begin anew, stand still, or go back a little in what came late.
        stamps: in s (n,).
        values: (n, 6).
    """
    stamps = stamps - stamps[0]
    changed = np.concatenate(([0], np.flatnonzero(np.diff(ticks)) + 1))
    steps, elapsed = _steps(ticks[changed]), np.diff(stamps[changed])
    usual = (np.abs(steps) < FURTHEST) & (np.abs(elapsed) < FURTHEST_APART)
    counted, passed = int(steps[usual].sum()), float(elapsed[usual].sum())
    if counted <= 0 or passed <= 0.0:
        return _ascending(stamps, values)
    series = np.concatenate(([0], np.cumsum(_steps(ticks)))) * (passed / counted)
    return _ascending(_near(stamps, series), values)


def _steps(ticks: NDArray[np.int32]) -> NDArray[np.int64]:
    return np.diff(ticks).astype(np.int64)  # an int32 wraps as the counter does


def _near(stamps: Array, series: Array) -> Array:
    """Return `series`, shifted anew wherever it parts from `stamps` by more than a `PAUSE`."""
    times = []
    shift = 0.0
    for stamp, time in zip(stamps.tolist(), series.tolist(), strict=True):
        if abs(time + shift - stamp) > PAUSE:
            shift = stamp - time
        times.append(time + shift)
    return np.array(times)


def _ascending(times: Array, values: Array) -> Track:
    """Return what does not come late, from time 0."""
    newest = np.concatenate(([-np.inf], np.maximum.accumulate(times)[:-1]))
    kept = times > newest
    if not kept.all():
        logger.info("%d measurements came late or twice, and are left out", np.sum(~kept))
    times = times[kept]
    return Track(times - times[:1], np.ascontiguousarray(values[kept]))


# --------------------------------------------------------------------------------------------- recordings

_KINDS: Final = re.compile(r"<[iuf][1248]")


def _read_recording(content: bytes) -> Track:
    """Return what a recording of the driver holds: a line of JSON that names the fields, then records."""
    line, newline, records = content.partition(b"\n")
    if not newline or len(line) > LONGEST_HEADER:
        raise LoadError("offset 0: no line of JSON at its beginning")
    kind = _record(_json(line))
    count, cut = divmod(len(records), kind.itemsize)
    if count > MOST:
        raise LoadError(f"{count} measurements; {MOST} can be replayed")
    if cut:
        logger.warning("the last %d bytes of the recording are no whole record, and left out", cut)
    data = np.frombuffer(records, kind, count)
    values = data["raw"].astype(np.float64)
    wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if wrong.size:
        offset = len(line) + 1 + int(wrong[0]) * kind.itemsize
        raise LoadError(f"offset {offset}: a load that is not finite")
    if not count:
        return Track(np.empty(0), values)
    seconds = (data["stamp"] - data["stamp"][0]).astype(np.float64) * 1e-9
    return _paced(data["ticks"].astype(np.int32), seconds, values)


def _json(line: bytes) -> Mapping[str, Any]:
    try:
        header = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise LoadError(f"offset 0: no JSON in the first line: {str(error)[:80]}") from error
    if not isinstance(header, dict) or header.get("format") != "crtk-netft-recording":
        raise LoadError("offset 0: JSON, but no recording of a NetFT sensor")
    return header


def _record(header: Mapping[str, Any]) -> np.dtype[Any]:
    fields = []
    try:
        for name, kind, shape in header["fields"]:
            if not _KINDS.fullmatch(kind) or shape not in ([], [6]):
                raise ValueError(f"{kind} {shape}")
            fields.append((name, kind, tuple(shape)))
        record = np.dtype(fields)
        whole = all(
            record[name].kind == "i" and not record[name].shape for name in ("stamp", "ticks")
        )
        if not whole or record["raw"].shape != (6,):
            raise ValueError("stamp, ticks, raw")
    except (KeyError, TypeError, ValueError) as error:
        raise LoadError(f"offset 0: fields that are not known: {error}") from error
    return record


# ----------------------------------------------------------------------------------------------------- CSV

_AXES: Final = ("fx", "fy", "fz", "tx", "ty", "tz")
_TIMES: Final = ("time", "t", "seconds", "timestamp", "stamp")
_UNIT: Final = re.compile(r"\s*[\[(].*")
"""What may follow a name: ``Fx [N]``."""


class _Columns(NamedTuple):
    """Where time and the six axes are in a row."""

    indices: tuple[int, ...]

    def row(self, cells: Sequence[str]) -> list[float]:
        """Return time and load."""
        if len(cells) <= max(self.indices):
            raise LoadError(f"{len(cells)} columns, where {max(self.indices) + 1} are needed")
        row = []
        for index in self.indices:
            try:
                row.append(float(cells[index]))
            except ValueError as error:
                raise LoadError(f"{cells[index][:40]!r} is no number") from error
            if not math.isfinite(row[-1]):
                raise LoadError(f"{cells[index][:40]!r} is not finite")
        return row


def _read_csv(content: bytes) -> Track:
    """Return the rows of a text of numbers, with or without a line of names, with comments after ``#``."""
    own = content.startswith(b"#") and b'"crtk-netft-recording"' in content[:200]
    columns: _Columns | None = None
    numbers = array("d")
    lines = io.BytesIO(content.removeprefix(b"\xef\xbb\xbf"))
    for number, line in enumerate(lines, start=1):
        try:
            cells = _cells(line)
            if not cells:
                continue
            if columns is None:
                named = not all(_is_number(cell) for cell in cells)
                columns = _named(cells) if named else _Columns(tuple(range(7)))
                if named:
                    continue
            row = columns.row(cells)
            if numbers and row[0] < numbers[-7] and not own:
                raise LoadError(f"time goes back from {numbers[-7]!r} to {row[0]!r}")
            numbers.extend(row)
            if len(numbers) > 7 * MOST:
                raise LoadError(f"more than {MOST} measurements")
        except LoadError as error:
            if numbers and not line.endswith(b"\n"):
                logger.warning("line %d, the last one, is not whole and left out", number)
                break
            raise LoadError(f"line {number}: {error}") from error
    table = np.array(numbers).reshape(-1, 7)
    return _ascending(table[:, 0] * (1e-9 if own else 1.0), table[:, 1:])


def _cells(line: bytes) -> Sequence[str]:
    if len(line) > LONGEST_LINE and not line.startswith(b"#"):
        raise LoadError(f"{len(line)} bytes long")
    text, _, _ = line.decode("utf-8", "replace").partition("#")
    separator = next((mark for mark in ";\t," if mark in text), None)
    return [cell.strip().strip('"') for cell in text.strip().split(separator) if text.strip()]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _named(cells: Sequence[str]) -> _Columns:
    """Return where the columns are, from a line of names."""
    names = [_UNIT.sub("", cell).strip().lower() for cell in cells]
    axes = [(f"raw_{axis}", axis, axis.replace("t", "m")) for axis in _AXES]
    found = []
    for wanted in (_TIMES, *axes):
        known = [names.index(name) for name in wanted if name in names]
        if not known:
            raise LoadError(f"no column {' or '.join(wanted)} among {', '.join(names)[:200]}")
        found.append(known[0])
    return _Columns(tuple(found))
