"""How figures are summed up and printed; nothing here knows what is measured."""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console
from rich.table import Table

WIDTH = 110


def options(description: str, **numbers: tuple[float, str]) -> argparse.Namespace:
    """Parse the command line of a figure: each number has a default and a text."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, (default, text) in numbers.items():
        flag = "--" + name.replace("_", "-")
        described = f"{text} (default: {default})"
        parser.add_argument(flag, type=type(default), default=default, help=described)
    return parser.parse_args()


def spread(values: ArrayLike, scale: float = 1.0, digits: int = 0) -> list[str]:
    """Return p50, p99 and maximum of `values` times `scale`, as text."""
    array = np.asarray(values, dtype=float) * scale
    if array.size == 0:
        return ["-"] * 3
    found = (np.median(array), np.percentile(array, 99), array.max())
    return [f"{value:.{digits}f}" for value in found]


def ratio(ours: float, theirs: float) -> str:
    """Return how many times `theirs` goes into `ours`, as text."""
    return f"{ours / theirs:.2f}" if theirs else "-"


def stolen() -> float:
    """Return the CPU time (s) that the hypervisor has kept from this machine since it booted."""
    return int(Path("/proc/stat").read_text().split(maxsplit=9)[8]) / os.sysconf("SC_CLK_TCK")


_STOLEN_BEFORE = stolen()


def machine() -> str:
    """Return the line that says where a figure comes from."""
    models = (
        line.partition(":")[2].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    )
    load = os.getloadavg()[0]
    return (
        f"{next(models, platform.processor())}, {os.cpu_count()} cores, Linux {platform.release()}, "
        f"Python {platform.python_version()}, load {load:.1f}, "
        f"{stolen() - _STOLEN_BEFORE:.1f} s of CPU kept by the hypervisor meanwhile"
    )


def show(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], notes: Sequence[str] = ()
) -> None:
    """Print a table, the notes under it, and the machine."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if index else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    console = Console(width=WIDTH, highlight=False)
    console.print()
    console.print(table)
    for note in notes:
        console.print(note, soft_wrap=True)
    console.print(f"machine: {machine()}", soft_wrap=True)


def time_calls(call: Callable[[], object], calls: int, rounds: int = 15) -> list[float]:
    """Return the seconds that one call takes, one value for each round of `calls` calls."""
    per_call = []
    for _ in range(rounds):
        begin = time.perf_counter()
        for _ in range(calls):
            call()
        per_call.append((time.perf_counter() - begin) / calls)
    return per_call


def show_calls(title: str, cases: Mapping[str, Callable[[], object]], calls: int) -> None:
    """Time each case and print a table in microseconds."""
    rows = []
    for name, call in cases.items():
        call()
        values = np.array(time_calls(call, calls)) * 1e6
        rows.append([name, *(f"{v:.2f}" for v in (np.median(values), values.min(), values.max()))])
    notes = [f"of 15 rounds of {calls} calls each, in one process and one thread."]
    show(title, ("call", "median µs", "min µs", "max µs"), rows, notes)
