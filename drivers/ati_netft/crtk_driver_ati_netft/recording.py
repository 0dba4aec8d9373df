"""Recordings of a sensor's full-rate stream: a thread that writes them, and what reads them again.

Two formats, by the suffix of the file. Both begin with one line that holds a JSON object: what the sensor is,
its calibration, and the fields that follow. What comes after that line is, in a binary file, one `RECORD`
after the other, so that numpy opens it without this package:

    with open("load.ftrec", "rb") as file:
        header = json.loads(file.readline())
        fields = [(name, kind, tuple(shape)) for name, kind, shape in header["fields"]]
        data = np.fromfile(file, np.dtype(fields))

and in a ``.csv`` file, where the JSON stands behind a ``#``, a line of column names and a line for each
measurement. Both grow at the end only: a file that was cut off anywhere is whole up to its last record.
"""

from __future__ import annotations

import io
import json
import logging
import os
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from crtk_driver_ati_netft.blocks import MEASUREMENT, Block, BlockReader, BlockRing
from crtk_driver_ati_netft.calibration import SensorInfo
from crtk_driver_ati_netft.compensation import Tool
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_drivers.device import Severity
from crtk_drivers.errors import ConfigError
from crtk_drivers.samples import Vector

FORMAT: Final = "crtk-netft-recording"
VERSION: Final = 1
SUFFIX: Final = ".ftrec"
CSV_SUFFIX: Final = ".csv"

RECORD: Final = np.dtype(
    [
        ("stamp", "<i8"),
        ("ticks", "<i8"),
        ("sequence", "<u4"),
        ("status", "<u4"),
        ("raw", "<f8", (6,)),
        ("wrench", "<f8", (6,)),
    ]
)
"""A record of a binary file, 120 bytes: the fields of `blocks.MEASUREMENT`, little-endian and packed."""

_AXES: Final = ("fx", "fy", "fz", "tx", "ty", "tz")
COLUMNS: Final = (
    *("stamp", "ticks", "sequence", "status"),
    *(f"raw_{axis}" for axis in _AXES),
    *(f"wrench_{axis}" for axis in _AXES),
)
"""Of a CSV file; the stamp in ns since the epoch."""

LONGEST_HEADER: Final = 1 << 20
"""Bytes of the first line at most."""
PERIOD: Final = 0.1
"""Seconds between two writes; the ring of the device holds eighty times that."""
PATIENCE: Final = 1.0
"""Seconds that the last write may take."""

logger = logging.getLogger(__name__)


# ------------------------------------------------------------------------------------------------- format


def encode_header(values: Mapping[str, Any], csv: bool) -> bytes:
    """Return the beginning of a file. `values`: what the recording is of, for JSON."""
    fields = [
        [name, RECORD[name].base.str, list(RECORD[name].shape)] for name in RECORD.names or ()
    ]
    header = {"format": FORMAT, "version": VERSION, "fields": fields, **values}
    line = json.dumps(header, allow_nan=False).encode() + b"\n"
    return b"# " + line + ",".join(COLUMNS).encode() + b"\n" if csv else line


def encode_block(block: Block, csv: bool) -> bytes:
    """Return measurements as they stand in a file."""
    if not csv:
        return block.astype(RECORD, copy=False).tobytes()
    numbers = (block[name].tolist() for name in ("stamp", "ticks", "sequence", "status"))
    loads = (block[name].tolist() for name in ("raw", "wrench"))
    rows = zip(*numbers, *loads, strict=True)
    lines = (",".join(map(repr, (*row[:4], *row[4], *row[5]))) for row in rows)
    return "".join(f"{line}\n" for line in lines).encode()


def describe(
    config: NetFtConfig, profile: str, info: SensorInfo | None, bias: Vector, tool: Tool | None
) -> dict[str, Any]:
    """Return what the header says of a sensor, of how it is set, and of what is taken off."""
    sensor = {} if info is None else asdict(info)
    for name in ("rated", "transform"):
        if name in sensor:
            sensor[name] = sensor[name].tolist()
    return {
        "begun": datetime.now(UTC).isoformat(timespec="microseconds"),
        "units": {"stamp": "ns", "raw": "N, N m", "wrench": "N, N m"},
        "host": config.host,
        "profile": profile,
        "sensor": sensor,
        "frame_id": config.frame_id,
        "measuring_frame_id": config.measuring_frame_id or config.frame_id,
        "point": config.point,
        "rotation": config.rotation,
        "gravity": config.gravity,
        "bias": bias.tolist(),
        "tool": None if tool is None else {"mass": tool.mass, "center": tool.center.tolist()},
    }


def default_name(config: NetFtConfig) -> str:
    """Return a file name that says of which sensor and when."""
    host = "".join(c if c.isalnum() or c in ".-" else "_" for c in config.host)
    return f"netft-{host}-{datetime.now(UTC):%Y%m%dT%H%M%S.%fZ}{SUFFIX}"


def is_csv(path: Path) -> bool:
    """Whether a file of this name is text."""
    return path.suffix.lower() == CSV_SUFFIX


@dataclass(frozen=True, eq=False)
class Recording:
    """A file that was read.

    Attributes:
        header: what the sensor was: ``host``, ``product``, ``serial``, ``scale``, ``frame_id``, ...
        data: the measurements (n,), with the fields of `blocks.MEASUREMENT`. That of a binary file stays on
            disk until it is used.
        cut: bytes at the end that are no whole record.
    """

    header: Mapping[str, Any]
    data: Block
    cut: int = 0


def read_recording(path: str | Path) -> Recording:
    """Return what a file holds, of either format.

    Raises:
        ConfigError: it cannot be read, is no recording, or is of another version.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            line = file.readline(LONGEST_HEADER)
            header = _header(line, path)
            if line.startswith(b"#"):
                file.readline(LONGEST_HEADER)
                return _read_csv(header, file.read(), path)
            size = os.fstat(file.fileno()).st_size - len(line)
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", where=str(path)) from error
    count, cut = divmod(size, RECORD.itemsize)
    if not count:
        return Recording(header, np.empty(0, RECORD), cut)
    data = np.memmap(path, RECORD, mode="r", offset=len(line), shape=(count,))
    return Recording(header, data, cut)


def _header(line: bytes, path: Path) -> Mapping[str, Any]:
    try:
        header = json.loads(line.removeprefix(b"#"))
    except (ValueError, RecursionError) as error:
        raise ConfigError("is no recording: no JSON in its first line", where=str(path)) from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ConfigError(f"is no recording: its format is not {FORMAT}", where=str(path))
    if header.get("version") != VERSION:
        raise ConfigError(
            f"is a recording of version {header.get('version')}; known is {VERSION}",
            where=str(path),
            remedy="Update crtk-drivers.",
        )
    return header


def _read_csv(header: Mapping[str, Any], text: bytes, path: Path) -> Recording:
    whole = text[: text.rfind(b"\n") + 1]
    if not whole:
        return Recording(header, np.empty(0, MEASUREMENT), len(text))
    try:
        data = np.loadtxt(io.BytesIO(whole), MEASUREMENT, delimiter=",", ndmin=1)
    except ValueError as error:
        raise ConfigError(f"is damaged: {error}", where=str(path)) from error
    return Recording(header, data, len(text) - len(whole))


# ------------------------------------------------------------------------------------------------ recorder


class Recorder:
    """Writes what a reader brings into a file, with a thread of its own.

    It can be stopped and started again and goes on where it was, as a device is closed and opened again.
    What it cannot write (no space left) ends the recording, is told by `error` and in the log, and leaves
    the stream alone.

    Args:
        path: of the file, which must not exist; its suffix decides on the format.
        reader: of the measurements; from where it stands.
        header: what the recording is of.

    Raises:
        ConfigError: the file exists, or cannot be made.

    Attributes:
        written: measurements that are in the file.
        error: why it ended by itself; empty if it did not.
    """

    def __init__(self, path: Path, reader: BlockReader, header: Mapping[str, Any]) -> None:
        self.path = path
        self.written = 0
        self.error = ""
        self._reader = reader
        self._csv = is_csv(path)
        self._thread: threading.Thread | None = None
        self._before: threading.Thread | None = None
        self._stop = threading.Event()
        beginning = encode_header(header, self._csv)
        try:
            with open(path, "xb") as file:
                file.write(beginning)
        except FileExistsError as error:
            raise ConfigError(
                "exists already", where=str(path), remedy="Give another name, or remove it."
            ) from error
        except OSError as error:
            raise ConfigError(f"cannot be written: {error.strerror}", where=str(path)) from error
        self.size = len(beginning)
        """Bytes that are in the file."""

    @property
    def missed(self) -> int:
        """Measurements that came faster than they could be written."""
        return self._reader.missed

    def start(self) -> None:
        """Go on writing. Does nothing while it runs, or after an error."""
        if self._thread is not None or self.error:
            return
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=self._run,
            args=(self._stop, self._before),
            name=f"record {self.path.name}",
            daemon=True,
        )
        self._thread.start()

    def stop(self) -> None:
        """Write what there is, and close the file. May be called twice."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._stop.set()
        self._before = thread
        thread.join(PATIENCE)
        if thread.is_alive():
            logger.error(
                "%s: still writing after %g s; the end may be missing", self.path, PATIENCE
            )

    def _run(self, stop: threading.Event, before: threading.Thread | None) -> None:
        if before is not None:
            before.join()  # on a slow disk it may not have come to its end
        if self.error:
            return
        try:
            with open(self.path, "ab", buffering=0) as file:
                while not stop.wait(PERIOD):
                    self._write(file)
                self._write(file)
                os.fsync(file.fileno())
        except OSError as error:
            self._fail(error)

    def _write(self, file: io.FileIO) -> None:
        block = self._reader.read(0.0)
        if not len(block):
            return
        left = memoryview(encode_block(block, self._csv))
        try:
            while left:
                left = left[file.write(left) :]
        except OSError:
            file.truncate(self.size)
            raise
        self.size = file.tell()
        self.written += len(block)

    def _fail(self, error: OSError) -> None:
        self.error = f"the recording {self.path} ended: {error.strerror or error}"
        logger.error("%s. It holds %d measurements.", self.error, self.written)


class Recordings:
    """The recording of one device, if there is one. Thread-safe.

    Args:
        ring: of the device; open while the device is.
    """

    def __init__(self, ring: BlockRing) -> None:
        self.recorder: Recorder | None = None
        self._ring = ring
        self._lock = threading.Lock()

    def begin(self, path: Path, header: Mapping[str, Any]) -> Recorder:
        """See `NetFtDevice.start_recording`."""
        with self._lock:
            if self.recorder is not None and not self.recorder.error:
                raise ConfigError(
                    f"a recording goes on: {self.recorder.path}", remedy="Stop it first."
                )
            self.recorder = recorder = Recorder(path, self._ring.reader(), header)
            if self._ring.is_open:
                recorder.start()
            return recorder

    def end(self) -> Recorder | None:
        """See `NetFtDevice.stop_recording`."""
        with self._lock:
            recorder, self.recorder = self.recorder, None
            if recorder is not None:
                recorder.stop()
            return recorder

    def resume(self) -> None:
        """The device is open."""
        with self._lock:
            if self.recorder is not None:
                self.recorder.start()

    def pause(self) -> None:
        """The device is closed."""
        with self._lock:
            if self.recorder is not None:
                self.recorder.stop()

    def notes(self) -> list[tuple[Severity, str, str]]:
        """Return what people should know: severity, key, text."""
        recorder = self.recorder
        if recorder is None:
            return []
        if recorder.error:
            return [(Severity.ERROR, "recording", recorder.error)]
        text = f"{recorder.written} measurements in {recorder.path}"
        if recorder.missed:
            return [(Severity.WARNING, "recording", f"{recorder.missed} missed, {text}")]
        return [(Severity.INFO, "recording", text)]
