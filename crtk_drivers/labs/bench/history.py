"""Runs against each other: what became worse, and by more than it usually varies."""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from crtk_drivers.labs.bench.results import DeviceResult, Measured, Run, read_run
from crtk_drivers.labs.verdicts.judging import number, with_unit

__all__ = ["INDEX", "add_to_index", "compared", "earlier_values", "read_index"]

INDEX: Final = "index.jsonl"
"""Beside the folders of runs: one measurement a line."""

NEWEST: Final = 20
"""Earlier runs that are looked at."""

ENOUGH: Final = 5
"""Earlier runs from which on a change is called a regression."""

SPREADS: Final = 3.0 * 1.48
"""Times the median absolute deviation of the earlier runs: three standard deviations, if they were normal."""

Key = tuple[str, str, str]
"""DeviceResult, id of the quantity, part."""


def add_to_index(run: Run, runs: Path, folder: str) -> None:
    """Append the measurements of a run to the index beside it.

    Raises:
        OSError: it cannot be written.
    """
    with (runs / INDEX).open("a", encoding="utf-8") as file:
        for device, test in run.tests:
            for found in test.measurements:
                if found.value is None:
                    continue
                line = {
                    "run": folder,
                    "started": run.started,
                    "lab": run.lab,
                    "device": device.name,
                    "configuration": device.configuration_sha256,
                    "firmware": device.firmware,
                    "test": test.id,
                    "id": found.id,
                    "part": found.part,
                    "unit": found.unit,
                    "value": found.value,
                    "verdict": found.verdict,
                }
                file.write(json.dumps(line) + "\n")


def read_index(runs: Path, lab: str) -> dict[Key, list[tuple[str, float]]]:
    """Return earlier values of a lab, each with its run, the oldest first; a broken line is left out."""
    found: dict[Key, list[tuple[str, float]]] = {}
    try:
        lines = (runs / INDEX).read_text("utf-8").splitlines()
    except OSError:
        return found
    for line in lines:
        try:
            entry: Mapping[str, Any] = json.loads(line)
            if entry["lab"] == lab:
                key = (entry["device"], entry["id"], entry["part"])
                found.setdefault(key, []).append((entry["run"], float(entry["value"])))
        except (ValueError, KeyError, TypeError):
            continue  # the last line of a machine that lost its power
    return found


def earlier_values(folders: Iterable[Path], lab: str) -> dict[Key, list[tuple[str, float]]]:
    """Return the values of runs that are named, as `read_index` does.

    Raises:
        ConfigError: one of them is no run.
    """
    found: dict[Key, list[tuple[str, float]]] = {}
    for folder in folders:
        run = read_run(folder)
        for device, test in run.tests:
            for one in test.measurements:
                if one.value is not None and run.lab == lab:
                    key = (device.name, one.id, one.part)
                    found.setdefault(key, []).append((folder.name, one.value))
    return found


def compared(run: Run, earlier: Mapping[Key, list[tuple[str, float]]], enough: int = ENOUGH) -> Run:
    """Return the run with what became worse said so, of figures that `enough` earlier runs have."""

    def judged(device: DeviceResult, found: Measured) -> Measured:
        values = earlier.get((device.name, *found.key), ())
        told = worse(found, [value for _, value in values][-NEWEST:], enough)
        return found.model_copy(update={"regressed": told})

    devices = []
    for device in run.devices:
        tests = [
            test.model_copy(
                update={"measurements": tuple(judged(device, found) for found in test.measurements)}
            )
            for test in device.tests
        ]
        devices.append(device.model_copy(update={"tests": tuple(tests)}))
    return run.model_copy(update={"devices": tuple(devices)})


def worse(found: Measured, earlier: list[float], enough: int = ENOUGH) -> str:
    """Return in words by how much a measurement is worse than it was; empty if it is not, or may not be."""
    if found.value is None or len(earlier) < enough:
        return ""
    usual = statistics.median(earlier)
    spread = statistics.median(abs(value - usual) for value in earlier)
    room = max(SPREADS * spread, found.guard)
    change = found.value - usual
    amount = {"higher": change, "lower": -change, "either": abs(change)}[found.worse]
    if amount <= room:
        return ""
    return (
        f"{with_unit(found.value, found.unit)}, usually {number(usual)} ± {number(room)} "
        f"({len(earlier)} runs)"
    )
