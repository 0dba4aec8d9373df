"""Recordings as tables, a file a topic: CSV, or Parquet where pyarrow is installed."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np

from crtk_drivers.errors import MissingExtra, RecordingError
from crtk_drivers.labs.tapes.clocks import clocks_of
from crtk_drivers.labs.tapes.rows import TIMES, Cell, rows_of
from crtk_drivers.recording import Message, Recording
from crtk_drivers.recording.foreign import Foreign

BATCH: Final = 20_000
"""Rows that are written together."""

_TIME_KINDS: Final = dict(zip(TIMES, (int, int, int, str), strict=True))

FORMATS: Final = ("csv", "parquet")


def convert(
    recording: Recording | Foreign, folder: Path, kind: str, topics: Sequence[str] = ()
) -> tuple[list[tuple[str, Path, int]], str]:
    """Write a table for each topic; return topic, file and rows of each, and what is to be known of clocks.

    Args:
        recording: opened.
        folder: of the tables, which is made; nothing in it is written over.
        kind: one of `FORMATS`.
        topics: to be written; all if there are none.

    Raises:
        RecordingError: there is no such topic, or a file cannot be written.
        MissingExtra: pyarrow is not installed.
    """
    write = _write_csv if kind == "csv" else _parquet_writer()
    written, late = [], {}
    chosen = topics or [topic for topic, count in recording.counts.items() if count]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for topic, name in zip(chosen, _file_names(chosen), strict=True):
            path = folder / f"{name}.{kind}"
            if path.exists():
                raise RecordingError(
                    "is there already", where=str(path), remedy="Choose another folder."
                )
            kinds = _columns(recording.messages(topic))
            columns = {**_TIME_KINDS, **kinds}
            late[topic] = array("d")
            rows = _rows(recording.messages(topic), tuple(kinds), late[topic])
            written.append((topic, path, write(path, columns, rows)))
    except OSError as error:
        raise RecordingError(
            f"cannot be written: {error.strerror or error}",
            where=str(folder),
            remedy="See whether the disk is full, and whether the folder can be written.",
        ) from error
    measured = {
        topic: np.array(seconds)
        for topic, seconds in late.items()
        if topic.rpartition("/")[2].startswith("measured_")
    }
    return written, clocks_of(measured, recording).note


def _columns(messages: Iterator[Message]) -> dict[str, type]:
    """Return all that messages say, and what each is: some may say less than others, or other things."""
    kinds: dict[str, type] = {}
    for message in messages:
        for _, _, row in rows_of(message):
            for name, cell in row.items():
                kind = type(cell)
                kinds[name] = kind if kinds.get(name, kind) is kind else str
    return kinds


def _rows(
    messages: Iterator[Message], names: Sequence[str], late: array[float]
) -> Iterator[list[Cell | None]]:
    """Yield the rows of a topic, and put into `late` by how much each valid one came after its stamp (s)."""
    for message in messages:
        for stamp_ns, frame_id, row in rows_of(message):
            if stamp_ns:
                late.append(1e-9 * (message.log_time - stamp_ns))
            cells = [row.get(name) for name in names]
            yield [message.log_time, message.publish_time, stamp_ns, frame_id, *cells]


def _write_csv(path: Path, columns: Mapping[str, type], rows: Iterator[list[Cell | None]]) -> int:
    count = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for count, row in enumerate(rows, 1):  # noqa: B007 - how many there were
            writer.writerow(row)
    return count


def _parquet_writer() -> Any:
    try:
        arrow: Any = import_module("pyarrow")
        parquet: Any = import_module("pyarrow.parquet")
    except ImportError as error:
        raise MissingExtra("pyarrow", "parquet") from error
    known = {int: arrow.int64(), float: arrow.float64(), bool: arrow.bool_(), str: arrow.string()}

    def write(path: Path, columns: Mapping[str, type], rows: Iterator[list[Cell | None]]) -> int:
        schema = arrow.schema([(name, known[kind]) for name, kind in columns.items()])
        count = 0
        with parquet.ParquetWriter(path, schema) as writer:
            for batch in _batches(rows):
                filled = zip(schema.types, columns.values(), zip(*batch, strict=True), strict=True)
                arrays = [
                    arrow.array([None if each is None else kind(each) for each in cells], its)
                    for its, kind, cells in filled
                ]
                writer.write_table(arrow.table(arrays, schema=schema))
                count += len(batch)
        return count

    return write


def _batches(rows: Iterator[list[Cell | None]]) -> Iterator[list[list[Cell | None]]]:
    batch: list[list[Cell | None]] = []
    for row in rows:
        batch.append(row)
        if len(batch) == BATCH:
            yield batch
            batch = []
    if batch:
        yield batch


def _file_names(topics: Sequence[str]) -> Iterator[str]:
    """Yield a name for each topic; no two are the same."""
    used: set[str] = set()
    for topic in topics:
        name = re.sub(r"[^A-Za-z0-9_.-]+", "_", topic).strip("_.") or "topic"
        while name in used:
            name += "_"
        used.add(name)
        yield name
