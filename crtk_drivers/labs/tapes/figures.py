"""The pictures of a device in a recording, or of a plot, as data: what is drawn on which canvas does not
matter here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from crtk_drivers.labs.tapes.contents import DeviceTracks, Track
from crtk_drivers.labs.verdicts.judging import Plot
from crtk_drivers.samples import Array, Vector

COLOURS: Final = ("#1f6feb", "#d1570c", "#1a7f37", "#8250df", "#bf3989", "#57606a", "#9a6700")

STATES: Final[Mapping[str, str]] = MappingProxyType(
    {"ENABLED": "#4ac26b", "PAUSED": "#d4a72c", "DISABLED": "#afb8c1", "FAULT": "#e5534b"}
)
REFUSED: Final = "#cf222e"
COMMANDED: Final = "#1f6feb"

GAP: Final = 0.25
"""Seconds between two commands of a stream after which it is another one."""

MOST_NAMES: Final = 24
"""Commands and refusals of so many names have a row of their own."""

LARGEST: Final = 1e100
"""Beyond it, as where it is not finite, a value is left out."""

_AXES: Final = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Line:
    """A line of a panel; NaN interrupts it."""

    name: str
    x: Vector
    y: Vector
    colour: str
    is_dashed: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """Values over time, or over what else the figures are."""

    title: str
    unit: str
    lines: tuple[Line, ...]


@dataclass(frozen=True, slots=True)
class Band:
    """A row of what happened when: ``(begin, end, colour, word)``; an instant begins where it ends."""

    name: str
    spans: tuple[tuple[float, float, str, str], ...]


@dataclass(frozen=True, slots=True)
class Path:
    """The way of the tool: points (n, 3) in m, what it is, and how it is drawn."""

    name: str
    points: Array
    colour: str
    is_dashed: bool = False


@dataclass(frozen=True, slots=True)
class Figures:
    """All of one device, or a plot.

    Attributes:
        namespace: the heading; empty for none.
        begin, end: of what the panels go over.
        bands, panels, paths: from above.
        refused: when something was, which is a line through all panels.
        unit: of what the panels go over.
        across: what that is, where it is not time.
    """

    namespace: str
    begin: float
    end: float
    bands: tuple[Band, ...] = ()
    panels: tuple[Panel, ...] = ()
    paths: tuple[Path, ...] = ()
    refused: tuple[float, ...] = ()
    unit: str = "s"
    across: str = ""


def figures_of_plot(plot: Plot) -> Figures:
    """Return a plot as figures: one panel. Its axis is ``time, s``, or another one, perhaps with a unit."""
    lines, every = [], []
    for index, series in enumerate(plot.series):
        x, y = np.asarray(series.x, dtype=float), np.asarray(series.y, dtype=float)
        x = np.where(np.abs(x) < LARGEST, x, np.nan)
        every.append(x[np.isfinite(x)])
        lines.append(Line(series.name, x, y, COLOURS[index % len(COLOURS)]))
    begin, end = range_of(np.concatenate(every) if every else np.empty(0), 0.0)
    name, comma, unit = plot.x_label.rpartition(", ")
    if not comma:
        name, unit = plot.x_label, ""
    across = "" if name == "time" else name
    panel = Panel(plot.title, plot.y_label, tuple(lines))
    return Figures("", begin, end, panels=(panel,), unit=unit, across=across)


def range_of(values: Array, room: float) -> tuple[float, float]:
    """Return from where to where an axis goes that shows values, with a share of that as room at each end."""
    if values.size == 0:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if high - low > 1e-9 * max(1.0, abs(high), abs(low)):
        return low - room * (high - low), high + room * (high - low)
    beside = 0.05 * abs(high) or 0.5
    return low - beside, high + beside


def figures_of(device: DeviceTracks, begin: float, end: float) -> Figures:
    """Return the pictures of one device between two times in s."""
    return Figures(
        device.namespace,
        begin,
        end,
        tuple(_bands(device, begin, end)),
        tuple(panel for panel in _panels(device.tracks) if panel.lines),
        tuple(_paths(device.tracks)),
        tuple(at for at, _, _ in device.refusals),
    )


def _panels(tracks: Mapping[str, Track]) -> Iterator[Panel]:
    measured, setpoint = tracks.get("measured_js"), tracks.get("setpoint_js")
    units = {"position": "rad, m", "velocity": "rad/s, m/s", "effort": "N·m, N"}
    for part, unit in units.items():
        title = f"{part.capitalize()}: measured, and the setpoint dashed"
        yield Panel(title, unit, tuple(_beside(measured, setpoint, part)))
        if part == "position":
            yield Panel("Error: setpoint less measured", unit, tuple(_errors(measured, setpoint)))
    wrench = tracks.get("measured_cf")
    yield Panel("Force", "N", tuple(_lines(wrench, "force", False)))
    yield Panel("Torque", "N·m", tuple(_lines(wrench, "torque", False)))


def _beside(measured: Track | None, setpoint: Track | None, part: str) -> Iterator[Line]:
    found = list(_lines(measured, part, False))
    yield from _lines(setpoint, part, True, is_named=not found)
    yield from found


def _lines(
    track: Track | None, part: str, is_dashed: bool, is_named: bool = True
) -> Iterator[Line]:
    if track is None:
        return
    for index, (name, values) in enumerate(track.part(part).items()):
        if np.isfinite(values).any():
            colour = COLOURS[index % len(COLOURS)]
            yield Line(_short(name) if is_named else "", track.times, values, colour, is_dashed)


def _errors(measured: Track | None, setpoint: Track | None) -> Iterator[Line]:
    if measured is None or setpoint is None:
        return
    found = measured.part("position")
    for index, (name, wanted) in enumerate(setpoint.part("position").items()):
        here = found.get(name)
        if here is None or not np.isfinite(wanted).any():
            continue
        sound = np.isfinite(here)
        if sound.sum() < 2:
            continue
        between = np.interp(setpoint.times, measured.times[sound], here[sound])
        yield Line(_short(name), setpoint.times, wanted - between, COLOURS[index % len(COLOURS)])


def _paths(tracks: Mapping[str, Track]) -> Iterator[Path]:
    for name, colour, is_dashed in (
        ("setpoint_cp", COLOURS[1], True),
        ("measured_cp", COLOURS[0], False),
    ):
        track = tracks.get(name)
        parts = {} if track is None else track.part("position")
        if set(_AXES) <= set(parts):
            points = np.column_stack([parts[axis] for axis in _AXES])
            points = points[np.isfinite(points).all(axis=1)]
            if len(points):
                yield Path(name, points, colour, is_dashed)


def _bands(device: DeviceTracks, begin: float, end: float) -> Iterator[Band]:
    spans: list[tuple[float, float, str, str]] = []
    for at, state, detail in sorted(device.states, key=lambda each: each[0]):
        is_same = bool(spans) and spans[-1][3].partition(":")[0] == state
        if is_same and not detail:
            continue
        if spans:
            spans[-1] = (spans[-1][0], at, *spans[-1][2:])
        word = f"{state}: {detail}" if detail else state
        spans.append((max(at, begin), end, STATES.get(state, "#8250df"), word))
    if spans:
        yield Band("state", tuple(span for span in spans if span[1] > span[0]))
    for name, times in sorted(device.commands.items())[:MOST_NAMES]:
        yield Band(name, tuple((a, b, COMMANDED, "") for a, b in _runs(times)))
    refused: dict[str, list[float]] = {}
    for at, command, reason in device.refusals:
        refused.setdefault(f"{command}: {reason}", []).append(at)
    for name, times in list(refused.items())[:MOST_NAMES]:
        yield Band(name, tuple((at, at, REFUSED, "") for at in times))


def _runs(times: list[float]) -> Iterator[tuple[float, float]]:
    """Yield begin and end of each stream of commands."""
    begin = last = None
    for at in sorted(times):
        if begin is None or last is None:
            begin = at
        elif at - last > GAP:
            yield begin, last
            begin = at
        last = at
    if begin is not None and last is not None:
        yield begin, last


def _short(name: str) -> str:
    return name.removesuffix("_joint")


def thinned(x: Vector, y: Vector, low: float, high: float, columns: int) -> Iterator[Array]:
    """Yield the parts of a line without a gap as points (n, 2): least and greatest of each column."""
    sound = np.isfinite(x) & np.isfinite(y) & (np.abs(y) < LARGEST) & (x >= low) & (x <= high)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], sound, [False])).astype(np.int8)))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        part_x, part_y = x[start:stop], y[start:stop]
        if part_x.size <= 2 * columns:
            yield np.column_stack((part_x, part_y))
            continue
        step = (high - low) / columns
        column = np.floor((part_x - low) / step).astype(np.int64)
        begins = np.flatnonzero(np.diff(column, prepend=column[0] - 1))
        least = np.minimum.reduceat(part_y, begins)
        greatest = np.maximum.reduceat(part_y, begins)
        points = np.empty((2 * begins.size, 2))
        points[0::2, 0] = points[1::2, 0] = part_x[begins]
        points[0::2, 1], points[1::2, 1] = least, greatest
        yield points
