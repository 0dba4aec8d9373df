"""What was measured, as comma-separated values under a line of names: m, and quaternions x, y, z, w."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from crtk_drivers.config.capped_file import read_capped
from crtk_drivers.errors import ConfigError
from crtk_drivers.samples import Array, Pose, vector

POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
POINT: Final = POSE[:3]

LARGEST: Final = 16 * 1024 * 1024
"""Bytes of a table."""


def columns_of(body: str, parts: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns of a body: ``arm_x``; without a name, ``x``."""
    return tuple(f"{body}_{part}" if body else part for part in parts)


def read_table(path: Path, bodies: Sequence[str], parts: Sequence[str]) -> dict[str, Array]:
    """Return the columns of each body, (n, len(parts)).

    Raises:
        ConfigError: the file cannot be read, lacks a column, or has something in it that is no number.
    """
    text = read_capped(path, LARGEST, "a table (CSV)").decode("utf-8", "replace")
    rows = csv.reader(io.StringIO(text), skipinitialspace=True)
    names = [name.strip() for name in next(rows, [])]
    wanted = [name for body in bodies for name in columns_of(body, parts)]
    if lacking := [name for name in wanted if name not in names]:
        raise ConfigError(
            f"lacks the columns {', '.join(lacking)}",
            where=str(path),
            remedy=f"Its first line is to be: {','.join(wanted)}",
        )
    places = [names.index(name) for name in wanted]
    numbers = [_numbers(row, places, path, rows.line_num) for row in rows if row]
    table = np.array(numbers, dtype=np.float64).reshape(-1, len(wanted))
    return dict(zip(bodies, np.split(table, len(bodies), axis=1), strict=True))


def _numbers(row: list[str], places: Sequence[int], path: Path, line: int) -> list[float]:
    try:
        return [float(row[place]) for place in places]
    except (ValueError, IndexError) as error:
        raise ConfigError(
            f"line {line} has not the numbers that its first line names: {error}",
            where=str(path),
            remedy="Mend the line, or leave it out.",
        ) from error


def poses_of(rows: Array) -> list[Pose]:
    """Return the poses of rows (n, 7)."""
    return [Pose(vector(row[:3]), vector(row[3:])) for row in rows]


def rows_of(poses: Sequence[Pose]) -> Array:
    """Return poses as rows (n, 7)."""
    return np.array([(*pose.position, *pose.orientation) for pose in poses]).reshape(-1, 7)


def write_table(path: Path, bodies: Mapping[str, Array], parts: Sequence[str]) -> None:
    """Write a table that `read_table` reads.

    Raises:
        ConfigError: it cannot be written.
    """
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow([name for body in bodies for name in columns_of(body, parts)])
            writer.writerows(np.concatenate(list(bodies.values()), axis=1).tolist())
    except OSError as error:
        raise ConfigError(
            f"cannot be written: {error.strerror or error}",
            where=str(path),
            remedy="Check path and rights.",
        ) from error
