"""Recordings of RTDE outputs as text, in the format of the vendor's own `record.py`.

The first line has the names, every further one a control period::

    timestamp actual_q_0 actual_q_1 actual_q_2 actual_q_3 actual_q_4 actual_q_5 robot_mode
    12.002 0.0 -1.57 1.57 -1.57 -1.57 0.0 7

Columns are separated by a space; a comma, a semicolon or a tab are read as well. A vector has one column
for each item, its number behind the name. Types and units are those of the variables
(:mod:`~crtk_sim_backends.ur.signals.variables`). A file whose name ends in ``.gz`` is compressed.

Source: UR "RTDE_Python_Client_Library", examples/record.py and csv_writer.py.
"""

from __future__ import annotations

import csv
import gzip
import itertools
import logging
import math
import threading
import zlib
from array import array
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TextIO

from crtk_sim_backends.faults import unknown
from crtk_sim_backends.ur.signals.variables import OUTPUTS, TYPES, Variable
from crtk_sim_backends.ur.versions import Version

TIME: Final = "timestamp"
USUAL: Final = (
    "target_q target_qd actual_q actual_qd actual_current actual_TCP_pose actual_TCP_speed "
    "actual_TCP_force target_TCP_pose robot_mode safety_mode runtime_state robot_status_bits "
    "safety_status_bits speed_scaling target_speed_fraction actual_digital_input_bits "
    "actual_digital_output_bits"
)
"""What is recorded when nothing else is asked for."""

MOST: Final = 30_000_000
"""Numbers that a recording may have: 10 minutes of 100 columns at 500 Hz."""

_SEPARATORS: Final = ";\t, "
_WRITE_PERIOD: Final = 0.2  # s
_WAITING_LIMIT: Final = 100_000  # rows that wait to be written; more are lost

Image = Mapping[str, Any]

log = logging.getLogger(__name__)


class RecordingError(ValueError):
    """A recording that cannot be written or read; says which file, and where in it."""


def chosen_variables(names: Iterable[str], version: Version) -> list[Variable]:
    """Return the output variables of those names, the time first.

    Raises:
        RecordingError: a name that this software does not have, with the nearest that it has.
    """
    known = {
        name: variable for name, variable in OUTPUTS.items() if variable.since.reached_by(version)
    }
    found = {TIME: known[TIME]}
    for name in names:
        if name not in known:
            raise RecordingError(unknown("output variable", name, known))
        found[name] = known[name]
    return list(found.values())


def columns_of(variable: Variable) -> list[str]:
    """Return the names of a variable's columns."""
    count = TYPES[variable.type].count
    return [variable.name] if count == 1 else [f"{variable.name}_{i}" for i in range(count)]


def _open(path: Path, mode: str) -> TextIO:
    """Open for reading (r) or, if there is none yet, for writing (x)."""
    opener: Callable[..., Any] = gzip.open if path.suffix == ".gz" else open
    opened: TextIO = opener(path, mode + "t", encoding="utf-8", newline="")
    return opened


class Recorder:
    """Writes variables to a file, from a thread of its own: a slow disk does not delay the controller.

    Args:
        path: of the file; none may be there yet.
        variables: what to record, see :func:`chosen_variables`.
        every: periods from one row to the next.

    Attributes:
        rows: that have been recorded.
        lost: rows that the disk was too slow for, or failed for.
        error: why writing has ended early; "" unless it has.

    Raises:
        RecordingError: the file exists, or cannot be made.
    """

    def __init__(self, path: Path, variables: Sequence[Variable], every: int) -> None:
        self.rows = 0
        self.lost = 0
        self.error = ""
        self._path = path
        self._every = every
        items = (
            f"*image[{v.name!r}]" if TYPES[v.type].count > 1 else f"image[{v.name!r}]"
            for v in variables
        )
        # One expression, as in the packages of RTDE; the names are those of the table.
        self._row: Callable[[Image], tuple[Any, ...]] = eval(f"lambda image: ({', '.join(items)},)")
        self._waiting: deque[tuple[Any, ...]] = deque()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        try:
            self._file = _open(path, "x")
            self._file.write(" ".join(itertools.chain(*map(columns_of, variables))) + "\n")
        except FileExistsError as error:
            raise RecordingError(
                f"{path} is there already; move it, or give another name"
            ) from error
        except OSError as error:
            raise RecordingError(f"cannot write {path}: {error.strerror}") from error

    def start(self) -> None:
        """Begin to write what is added."""
        self._thread.start()

    def add(self, image: Image, tick: int) -> None:
        """Record the outputs of a period, if it is one that is recorded."""
        if tick % self._every:
            return
        if self.error or len(self._waiting) >= _WAITING_LIMIT:
            self.lost += 1
            return
        self._waiting.append(self._row(image))
        self.rows += 1

    @property
    def status(self) -> dict[str, Any]:
        """What was recorded, ready for JSON."""
        return {
            "path": str(self._path),
            "rows": self.rows,
            "lost": self.lost,
            "error": self.error,
        }

    def close(self) -> None:
        """Write what is left, and close the file; safe to repeat."""
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join()
        try:
            self._file.close()
        except OSError as error:
            if not self.error:
                self._fail(error)
        if self.lost:
            log.warning(
                "%s lacks at least %d rows: %s", self._path, self.lost, self.error or "a slow disk"
            )
            self.lost = 0

    def _write(self) -> None:
        ended = False
        while not (ended or self.error):
            ended = self._ending.wait(_WRITE_PERIOD)
            try:
                while self._waiting:
                    self._file.write(" ".join(map(repr, self._waiting.popleft())) + "\n")
                self._file.flush()
            except OSError as error:
                self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.error = f"cannot write {self._path}: {error.strerror}"
        self.lost += len(self._waiting) + 1
        log.error("the recording has ended: %s", self.error)


@dataclass(frozen=True)
class Recording:
    """A recording in memory.

    Attributes:
        variables: its columns, the time left out.
        times: timestamp of each row, s, ascending.
        values: the other columns of all rows, one row after the other.
    """

    variables: tuple[Variable, ...]
    times: array[float]
    values: array[float]

    @property
    def rows(self) -> int:
        """Number of rows, at least one."""
        return len(self.times)

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return self.times[-1] - self.times[0]

    @cached_property
    def width(self) -> int:
        """Numbers in a row, without the time."""
        return sum(TYPES[variable.type].count for variable in self.variables)

    def column(self, name: str) -> array[float]:
        """Values of a scalar in all rows."""
        before = itertools.takewhile(lambda variable: variable.name != name, self.variables)
        return self.values[sum(TYPES[variable.type].count for variable in before) :: self.width]

    def row(self, index: int) -> dict[str, Any]:
        """Values of a row by name, in their types; vectors are tuples."""
        position = index * self.width
        found: dict[str, Any] = {}
        for variable in self.variables:
            wire = TYPES[variable.type]
            items = self.values[position : position + wire.count]
            position += wire.count
            convert = type(wire.zero)
            found[variable.name] = (
                tuple(map(convert, items)) if wire.count > 1 else convert(items[0])
            )
        return found


def read_recording(path: Path) -> Recording:
    """Return a recording, all of it.

    A last line that is not whole, as a recorder leaves it that was killed, is left out with a warning.

    Raises:
        RecordingError: it cannot be read, names an unknown variable or half a vector, has a value that is
            no number, or a time that goes back.
    """
    try:
        with _open(path, "r") as file:
            return _read(path, file)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error
    except (OSError, EOFError, UnicodeDecodeError, csv.Error, zlib.error) as error:
        raise RecordingError(f"cannot read {path}: {error}") from error


def _read(path: Path, file: TextIO) -> Recording:
    header = file.readline().removeprefix("\ufeff").strip()
    separator = next((mark for mark in _SEPARATORS if mark in header), " ")
    names = [name.strip().strip('"') for name in header.split(separator) if name]
    variables = list(_variables(names))
    if not variables or variables[0].name != TIME:
        raise RecordingError(f"line 1: the first column must be {TIME}, not {names[:1] or 'none'}")
    times, values = array("d"), array("d")
    for number, line in enumerate(file, start=2):
        cells = line.split(separator) if separator != " " else line.split()
        try:
            row = [_number(cell) for cell in cells]
            if len(row) != len(names):
                raise RecordingError(f"{len(row)} columns, not {len(names)} as in line 1")
        except RecordingError as error:
            if not line.endswith("\n"):
                log.warning("%s: line %d, the last one, is not whole and left out", path, number)
                break
            raise RecordingError(f"line {number}: {error}") from error
        if times and row[0] < times[-1]:
            raise RecordingError(f"line {number}: the time goes back to {row[0]!r}")
        times.append(row[0])
        values.extend(row[1:])
        if len(values) > MOST:
            raise RecordingError(f"line {number}: more than {MOST} numbers")
    if not times:
        raise RecordingError("has no rows")
    return Recording(tuple(variables[1:]), times, values)


def _variables(columns: Sequence[str]) -> Iterator[Variable]:
    """Yield the variables that the columns make up."""
    rest = list(columns)
    while rest:
        name, _, number = rest[0].rpartition("_")
        variable = OUTPUTS.get(rest[0]) or (OUTPUTS.get(name) if number == "0" else None)
        if variable is None:
            raise RecordingError(f"line 1: {unknown('output variable', rest[0], OUTPUTS)}")
        expected = columns_of(variable)
        found, rest = rest[: len(expected)], rest[len(expected) :]
        if found != expected:
            raise RecordingError(f"line 1: {variable.name} needs the columns {' '.join(expected)}")
        yield variable


def _number(cell: str) -> float:
    text = cell.strip().strip('"')
    try:
        number = float({"True": "1", "False": "0"}.get(text, text))
    except ValueError as error:
        raise RecordingError(f"{text[:40]!r} is no number") from error
    if not math.isfinite(number):
        raise RecordingError(f"{text[:40]!r} is not finite")
    return number
