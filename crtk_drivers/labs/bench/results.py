"""What a run found, as it is stored in ``run.json``: reports, JUnit and comparisons are made of that.

Schema ``crtk_bench/1``; ``crtk-driver bench schema`` prints it. Numbers have the unit of their quantity.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.bench.acquisition import BenchTest
from crtk_drivers.labs.verdicts.judging import Findings, Measurement, Verdict, verdict_of
from crtk_drivers.labs.verdicts.judging import Plot as PlotValue

SCHEMA: Final = "crtk_bench/1"

LARGEST: Final = 200 * 1024 * 1024
"""Bytes of a run.json that are read."""


class _Stored(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="constants")


class Line(_Stored):
    """A line of a plot."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]


class Plot(_Stored):
    """What is drawn beside the figures."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Line, ...]


class Measured(_Stored):
    """One measurement.

    `value`, `lower` and `upper` (95 %) are null if it could not be measured, bounds if there are none.
    """

    id: str
    title: str
    part: str
    unit: str
    value: float | None
    lower: float | None
    upper: float | None
    n: int
    comparison: Literal["at most", "at least", "within", "told"]
    bound: float | None
    bound_lower: float | None
    bound_from: str
    worse: Literal["higher", "lower", "either"]
    guard: float
    verdict: Verdict
    marginal: bool
    told: str
    why: str
    regressed: str = Field(
        default="", description="Against earlier runs, in words; empty if it is not."
    )


class Result(_Stored):
    """One test of one device."""

    id: str
    name: str
    group: str
    acquisition: str
    verdict: Verdict
    reason: str = ""
    seconds: float = 0.0
    recording: str = Field(default="", description="File with the raw data, relative to the run.")
    measurements: tuple[Measured, ...] = ()
    plots: tuple[Plot, ...] = ()


class DeviceResult(_Stored):
    """One device of the lab."""

    name: str
    plugin: str
    address: str
    simulated: bool = Field(description="No hardware is behind it.")
    firmware: dict[str, str] = Field(default_factory=dict, description="Its readings at the begin.")
    configuration_sha256: str = ""
    trouble: str = Field(default="", description="Why it was not tested, or not to the end.")
    tests: tuple[Result, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Of all tests."""
        return verdict_of(test.verdict for test in self.tests)


class Run(_Stored):
    """One run of the bench."""

    schema_: str = Field(default=SCHEMA, alias="schema")
    lab: str
    lab_file: str
    lab_file_sha256: str
    suite: str
    started: str
    seconds: float = 0.0
    complete: bool = Field(default=False, description="It came to its end.")
    ended_by: str = Field(default="", description="Why it did not.")
    machine: dict[str, str] = Field(default_factory=dict)
    devices: tuple[DeviceResult, ...] = ()

    model_config = ConfigDict(
        extra="forbid", frozen=True, populate_by_name=True, ser_json_inf_nan="constants"
    )

    @property
    def tests(self) -> Iterator[tuple[DeviceResult, Result]]:
        """Every test with its device."""
        for device in self.devices:
            for test in device.tests:
                yield device, test

    @property
    def verdict(self) -> Verdict:
        """Of all devices."""
        return verdict_of(test.verdict for _, test in self.tests)


def test_of(test: BenchTest, findings: Findings, seconds: float, recording: str) -> Result:
    """Return what is stored of a test."""
    return Result(
        id=test.id,
        name=test.name,
        group=test.group,
        acquisition=test.acquisition.name,
        verdict=findings.verdict,
        reason=findings.reason,
        seconds=round(seconds, 3),
        recording=recording,
        measurements=tuple(map(measured_of, findings.measurements)),
        plots=tuple(map(_plot, findings.plots)),
    )


def measured_of(found: Measurement) -> Measured:
    """Return what is stored of a measurement."""
    quantity, estimate, bound = found.quantity, found.estimate, found.bound
    return Measured(
        id=quantity.id,
        title=quantity.title,
        part=found.part,
        unit=quantity.unit,
        value=None if estimate is None else estimate.value,
        lower=None if estimate is None else estimate.lower,
        upper=None if estimate is None else estimate.upper,
        n=0 if estimate is None else estimate.n,
        comparison=quantity.comparison.value,
        bound=None if bound is None else bound.value,
        bound_lower=None if bound is None or math.isinf(bound.lower) else bound.lower,
        bound_from="" if bound is None else bound.source,
        worse=quantity.worse.value,
        guard=quantity.guard,
        verdict=found.verdict,
        marginal=found.is_marginal,
        told=found.told,
        why=found.why,
    )


PLOTTED: Final = 1500
"""Points of a line that are kept in run.json; the recording has all."""


def _plot(plot: PlotValue) -> Plot:
    lines = []
    for series in plot.series:
        every = max(1, len(series.x) // PLOTTED)
        lines.append(
            Line(
                name=series.name,
                x=tuple(round(value, 6) for value in series.x[::every]),
                y=tuple(float(f"{value:.6g}") for value in series.y[::every]),
            )
        )
    return Plot(title=plot.title, x_label=plot.x_label, y_label=plot.y_label, series=tuple(lines))


def write_run(run: Run, folder: Path) -> None:
    """Write ``run.json``: the old one or the new one is there, whenever it is interrupted.

    Raises:
        OSError: it cannot be written.
    """
    write_whole(folder / "run.json", run.model_dump_json(by_alias=True, indent=1))


def write_whole(path: Path, text: str) -> None:
    """Write a file: the old one or the new one is there, whenever it is interrupted, and no part of it.

    Raises:
        OSError: it cannot be written.
    """
    beside = path.with_name(f"{path.name}.new")
    try:
        with beside.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except OSError:
        beside.unlink(missing_ok=True)
        raise


def read_run(folder: Path) -> Run:
    """Return the run of a folder.

    Raises:
        ConfigError: there is none, or it is of a newer version.
    """
    path = folder / "run.json" if folder.is_dir() else folder
    try:
        if path.stat().st_size > LARGEST:
            raise ConfigError("is too large for a run", where=str(path))
        found: Any = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"is no run of the bench: {error}", where=str(path)) from error
    schema = found.get("schema") if isinstance(found, dict) else None
    if schema != SCHEMA:
        raise ConfigError(
            f"was written as {schema}; this version reads {SCHEMA}",
            where=str(path),
            remedy="Look at it with the version of crtk-drivers that wrote it.",
        )
    try:
        return Run.model_validate(found)
    except ValueError as error:
        raise ConfigError(f"cannot be read: {error}", where=str(path)) from error
