"""Runs against each other: what became worse, and by more than it usually varies.

A figure is compared with that of the same lab and device, simulated or real: a simulator tells nothing of
how hardware was. What a test could not decide (a machine that is too busy) is not compared. Beside the
folders of runs lie ``index.jsonl``, one measurement a line, and ``baseline.json``, which run each device is
compared with by ``--against baseline``.
"""

from __future__ import annotations

import fcntl
import json
import os
import statistics
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.bench.results import DeviceResult, Measured, Run, read_run, write_whole
from crtk_drivers.labs.lab_file import Lab
from crtk_drivers.labs.verdicts.judging import Verdict, number, with_unit

INDEX: Final = "index.jsonl"
"""Beside the folders of runs: one measurement a line."""

BASELINE: Final = "baseline.json"

NEWEST: Final = 20
"""Earlier runs that are looked at."""

ENOUGH: Final = 5
"""Earlier runs from which on a change is called a regression."""

SPREADS: Final = 3.0 * 1.48
"""Times the median absolute deviation of the earlier runs: three standard deviations, if they were normal."""


class Key(NamedTuple):
    """What makes it the same figure in another run of a lab."""

    device: str
    simulated: bool
    id: str
    part: str


class Earlier(NamedTuple):
    """A figure of an earlier run."""

    key: Key
    run: str
    value: float


def key_of(device: DeviceResult, found: Measured) -> Key:
    """Return by what a figure is compared."""
    return Key(device.name, device.simulated, found.id, found.part)


def add_to_index(run: Run, runs: Path, folder: str) -> None:
    """Append the measurements of a run to the index beside it, all of them or none.

    Raises:
        OSError: it cannot be written.
    """
    lines = []
    for device, test in run.tests:
        for found in test.measurements:
            if found.value is None:
                continue
            line = {
                "run": folder,
                "started": run.started,
                "lab": run.lab,
                "device": device.name,
                "simulated": device.simulated,
                "configuration": device.configuration_sha256,
                "firmware": device.firmware,
                "test": test.id,
                "test_verdict": test.verdict,
                "id": found.id,
                "part": found.part,
                "unit": found.unit,
                "value": found.value,
                "verdict": found.verdict,
            }
            lines.append(json.dumps(line) + "\n")
    _append(runs / INDEX, "".join(lines).encode())


def _append(path: Path, lines: bytes) -> None:
    """Append lines, whole ones beside another bench too; what a full disk does not take is taken back."""
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
    try:
        fcntl.flock(file, fcntl.LOCK_EX)
        size = os.fstat(file).st_size
        if size and os.pread(file, 1, size - 1) != b"\n":  # of a machine that lost its power
            lines = b"\n" + lines
        try:
            while lines:
                lines = lines[os.write(file, lines) :]
        except OSError:
            os.ftruncate(file, size)
            raise
    finally:
        os.close(file)


def read_index(runs: Path, lab: str) -> Iterator[Earlier]:
    """Yield the earlier values of a lab, the oldest first, without those of tests that decided nothing.

    Broken lines are left out. A line of a version that did not write whether it was simulated is looked up in
    its run, and left out if that is gone.
    """
    try:
        lines = (runs / INDEX).read_text("utf-8", "replace").splitlines()
    except OSError:
        return

    @cache
    def was_simulated(run: str) -> Mapping[str, bool]:
        return {device.name: device.simulated for device in read_run(runs / run).devices}

    for line in lines:
        try:
            entry: Mapping[str, Any] = json.loads(line)
            if entry["lab"] != lab or entry.get("test_verdict") == Verdict.INCONCLUSIVE:
                continue
            run, device = str(entry["run"]), str(entry["device"])
            simulated = entry["simulated"] if "simulated" in entry else was_simulated(run)[device]
            key = Key(device, bool(simulated), str(entry["id"]), str(entry["part"]))
            yield Earlier(key, run, float(entry["value"]))
        except (ValueError, KeyError, TypeError):  # no run there any more is a ValueError too
            continue


def make_baseline(folder: Path) -> Run:
    """Make a run what its devices are compared with by ``--against baseline``; return it.

    Raises:
        ConfigError: it is no run, it did not come to its end, or the file beside it cannot be written.
    """
    run = read_run(folder)
    if not run.complete:
        raise ConfigError(
            f"it did not come to its end{run.ended_by and ': '}{run.ended_by}",
            where=str(folder),
            remedy="Take one that did.",
        )
    path = folder.resolve().parent / BASELINE
    found = _read_baseline(path)
    of_lab = found.setdefault(run.lab, {})
    for device in run.devices:
        of_lab[_called(device.name, device.simulated)] = folder.resolve().name
    try:
        write_whole(path, json.dumps(found, indent=1) + "\n")
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", where=str(path)) from error
    return run


def _called(device: str, simulated: bool) -> str:
    return f"{device}, {'simulated' if simulated else 'real'}"


def _read_baseline(path: Path) -> dict[str, dict[str, str]]:
    """Return the run of each device, by lab."""
    try:
        found = json.loads(path.read_text("utf-8"))
        return {str(lab): {**devices} for lab, devices in found.items()}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise ConfigError(
            f"cannot be read: {error}",
            where=str(path),
            remedy="Remove it, and name a baseline anew: crtk-driver bench baseline RUN.",
        ) from error


def earlier_of(lab: Lab, runs: Path, against: str) -> list[Earlier]:
    """Return what the figures of a run of this lab are compared with, the oldest first.

    Args:
        lab: as it is to be tested; simulated devices are compared with simulated ones.
        runs: folder of its runs.
        against: ``all`` that the index has, ``previous`` (the newest of them), ``baseline``, or the folder
            of a run.

    Raises:
        ConfigError: a run was asked for by name, and has nothing that a device of this lab can be compared
            with.
    """
    wanted = {(device.name, device.simulated) for device in lab.devices.values()}

    def comparable(values: Iterable[Earlier]) -> list[Earlier]:
        return [one for one in values if (one.key.device, one.key.simulated) in wanted]

    if against in ("all", "previous"):
        found = comparable(read_index(runs, lab.name))
        return found if against == "all" else [one for one in found if one.run == found[-1].run]
    if against == "baseline":
        of_lab = _read_baseline(runs / BASELINE).get(lab.name, {})
        found = []
        for device, simulated in sorted(wanted):
            folder = of_lab.get(_called(device, simulated))
            if folder is not None:
                found += [one for one in _values(runs / folder, lab) if one.key.device == device]
        missing = "no run is the baseline"
        remedy = "crtk-driver bench baseline RUN makes one of that lab the baseline."
    else:
        found = _values(Path(against), lab)
        missing = "that run has no figure"
        remedy = "A simulated device is compared with a simulated one, of the same name."
    found = comparable(found)
    if not found:
        devices = "; ".join(_called(*each) for each in sorted(wanted))
        raise ConfigError(f"{missing} of {devices}", where=f"--against {against}", remedy=remedy)
    return found


def _values(folder: Path, lab: Lab) -> list[Earlier]:
    """Return the values of a run.

    Raises:
        ConfigError: it is no run, or of another lab.
    """
    run = read_run(folder)
    if run.lab != lab.name:
        raise ConfigError(f"is a run of the lab {run.lab!r}, not {lab.name!r}", where=str(folder))
    name = folder.resolve().name
    return [
        Earlier(key_of(device, one), name, one.value)
        for device, test in run.tests
        for one in test.measurements
        if one.value is not None and test.verdict is not Verdict.INCONCLUSIVE
    ]


def by_key(values: Iterable[Earlier]) -> dict[Key, list[float]]:
    """Return values by their figures, each in the order in which they came."""
    found: dict[Key, list[float]] = {}
    for one in values:
        found.setdefault(one.key, []).append(one.value)
    return found


def compared(run: Run, earlier: Mapping[Key, list[float]], enough: int = ENOUGH) -> Run:
    """Return the run with what became worse said so, of figures that `enough` earlier runs have."""

    devices = []
    for device in run.devices:
        tests = []
        for test in device.tests:
            found = []
            is_open = test.verdict is Verdict.INCONCLUSIVE
            for one in test.measurements:
                values = [] if is_open else earlier.get(key_of(device, one), [])[-NEWEST:]
                found.append(one.model_copy(update={"regressed": worse(one, values, enough)}))
            tests.append(test.model_copy(update={"measurements": tuple(found)}))
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
    now = with_unit(found.value, found.unit)
    if len(earlier) == 1:
        return f"{now}, was {number(usual)}; {number(room)} counts as no change"
    return f"{now}, usually {number(usual)} ± {number(room)} ({len(earlier)} runs)"
