"""Draws figures on a canvas: bands, panels over time, and the way of the tool from a corner above.

Pages of recordings and reports of the bench are drawn by it, and pictures of the docs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, Protocol

import numpy as np

from crtk_drivers.labs.tapes.figures import Band, Figures, Panel, Path, range_of, thinned
from crtk_drivers.labs.verdicts.judging import number
from crtk_drivers.samples import Array

WIDTH: Final = 1000
BESIDE_BANDS: Final = 176
LEFT: Final = 64
RIGHT: Final = 16
TOP: Final = 46
BAND: Final = 17
PANEL: Final = 210
PATH: Final = 420
BOTTOM: Final = 24
ACROSS: Final = 16
COLUMNS: Final = 600
"""Of a line with more points, the least and the greatest of each of so many columns are drawn."""

INK: Final = "ink"
FAINT: Final = "faint"
GRID: Final = "grid"
"""Colours that a canvas has its own of."""

ROOM: Final = 0.04
"""Share of the values above and below them."""

_TURN: Final = math.radians(35.0)
_TILT: Final = math.radians(28.0)

Points = Iterable[tuple[float, float]]


class Canvas(Protocol):
    """What can be drawn on; x to the right, y down, in px. Colours are ``#rrggbb``, or one of those above."""

    def line(self, points: Points, colour: str, width: float, is_dashed: bool) -> None:
        """Draw a line through points."""

    def box(self, x: float, y: float, width: float, height: float, colour: str, hint: str) -> None:
        """Fill a rectangle; a hint tells what it is."""

    def text(self, x: float, y: float, words: str, colour: str, anchor: str, is_bold: bool) -> None:
        """Write words whose line ends at y; `anchor` is start, middle or end."""


def height_of(figures: Figures) -> float:
    """Return the height that the figures of a device take."""
    bands = BAND * len(figures.bands) + 30 if figures.bands else 0
    heading = TOP if figures.namespace else 0
    rest = PANEL * len(figures.panels) + (PATH if figures.paths else 0)
    return heading + bands + rest + (ACROSS if figures.across else 0)


def draw(canvas: Canvas, figures: Figures, top: float) -> None:
    """Draw the figures of a device, from `top` down."""
    y = top
    if figures.namespace:
        canvas.text(16, top + 20, figures.namespace, INK, "start", True)
        y += TOP
    if figures.bands:
        _draw_bands(canvas, figures, y)
        y += BAND * len(figures.bands) + 30
    for panel in figures.panels:
        _draw_panel(canvas, figures, panel, y)
        y += PANEL
    if figures.across:
        middle = (_left(figures) + WIDTH - RIGHT) / 2.0
        canvas.text(middle, y + ACROSS / 2.0 - 4.0, figures.across, FAINT, "middle", False)
        y += ACROSS
    if figures.paths:
        _draw_paths(canvas, figures.paths, _left(figures), y)


def ticks(low: float, high: float) -> list[float]:
    """Return about five round values of a range."""
    rough = (high - low) / 5.0
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= rough)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [0.0 if index == 0 else index * step for index in range(first, last + 1)]


def _left(figures: Figures) -> int:
    """Return where panels begin: names of bands need their room."""
    return BESIDE_BANDS if figures.bands else LEFT


def _at(figures: Figures, time: float) -> float:
    span = max(1e-9, figures.end - figures.begin)
    left = _left(figures)
    return left + (time - figures.begin) / span * (WIDTH - left - RIGHT)


def _time_axis(canvas: Canvas, figures: Figures, top: float, bottom: float) -> None:
    for tick in ticks(figures.begin, max(figures.end, figures.begin + 1e-9)):
        x = _at(figures, tick)
        canvas.line(((x, top), (x, bottom)), GRID, 1, False)
        canvas.text(
            x, bottom + 14, f"{number(tick)} {figures.unit}".rstrip(), FAINT, "middle", False
        )


def _draw_bands(canvas: Canvas, figures: Figures, top: float) -> None:
    _time_axis(canvas, figures, top, top + BAND * len(figures.bands))
    for row, band in enumerate(figures.bands):
        _draw_band(canvas, figures, band, top + BAND * row)


def _draw_band(canvas: Canvas, figures: Figures, band: Band, top: float) -> None:
    begins = _left(figures)
    canvas.text(begins - 8, top + 12, _cut(band.name, begins - 16), FAINT, "end", False)
    for begin, end, colour, word in band.spans:
        left, right = _at(figures, begin), _at(figures, end)
        if right < begins or left > WIDTH - RIGHT:
            continue
        left, right = max(left, begins), min(right, WIDTH - RIGHT)
        canvas.box(left, top + 2, max(2.0, right - left), BAND - 4, colour, word or band.name)
        if word and right - left > 50:
            canvas.text(left + 4, top + 13, _cut(word, right - left - 8), "#1f2328", "start", False)


def _cut(words: str, width: float) -> str:
    fits = max(1, int(width / 6.0))
    return words if len(words) <= fits else f"{words[: fits - 1]}…"


def _draw_panel(canvas: Canvas, figures: Figures, panel: Panel, top: float) -> None:
    begins = _left(figures)
    unit = f" ({panel.unit})" if panel.unit else ""
    canvas.text(begins, top + 12, f"{panel.title}{unit}", INK, "start", True)
    x = float(begins)
    for line in panel.lines:
        if line.name:
            canvas.text(x, top + 28, line.name, line.colour, "start", False)
            x += 6.6 * len(line.name) + 14
    first, last = top + 36, top + PANEL - BOTTOM - 8
    parts = [
        (line, list(thinned(line.x, line.y, figures.begin, figures.end, COLUMNS)))
        for line in panel.lines
    ]
    found = [piece[:, 1] for _, pieces in parts for piece in pieces]
    low, high = range_of(np.concatenate(found) if found else np.empty(0), ROOM)

    def at_y(value: float) -> float:
        return last - (value - low) / (high - low) * (last - first)

    for tick in ticks(low, high):
        y = at_y(tick)
        canvas.line(((begins, y), (WIDTH - RIGHT, y)), GRID, 1, False)
        canvas.text(begins - 8, y + 4, number(tick), FAINT, "end", False)
    _time_axis(canvas, figures, first, last)
    for at in figures.refused[:500]:
        if figures.begin <= at <= figures.end:
            x = _at(figures, at)
            canvas.line(((x, first), (x, last)), "#f0a8a8", 1, False)
    for line, pieces in parts:
        for piece in pieces:
            points = [(_at(figures, x), at_y(y)) for x, y in piece.tolist()]
            canvas.line(points, line.colour, 1.4, line.is_dashed)


def _draw_paths(canvas: Canvas, paths: Sequence[Path], left: float, top: float) -> None:
    canvas.text(left, top + 12, "Way of the tool (m)", INK, "start", True)
    x = float(left)
    for path in paths:
        words = f"{path.name}{', dashed' if path.is_dashed else ''}"
        canvas.text(x, top + 28, words, path.colour, "start", False)
        x += 6.6 * len(words) + 14
    points = np.concatenate([path.points for path in paths])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2.0, float(max((high - low).max(), 1e-3))
    scale = 0.58 * (PATH - 60) / size
    origin = WIDTH / 2.0, top + 30 + (PATH - 30) / 2.0

    def seen(point: Array) -> list[tuple[float, float]]:
        x, y, z = (np.atleast_2d(point) - middle).T
        across = x * math.cos(_TURN) - y * math.sin(_TURN)
        depth = x * math.sin(_TURN) + y * math.cos(_TURN)
        up = z * math.cos(_TILT) + depth * math.sin(_TILT)
        places = zip(
            (origin[0] + scale * across).tolist(), (origin[1] - scale * up).tolist(), strict=True
        )
        return list(places)

    half = size / 2.0
    for axis, name in enumerate("xyz"):
        _draw_cube_edges(canvas, seen, middle, half, axis)
        ends = np.array([middle - half, middle - half])
        ends[1, axis] += size
        (begin, end) = seen(ends)
        canvas.line((begin, end), FAINT, 1.2, False)
        words = f"{name}: {number(ends[0, axis])} to {number(ends[1, axis])}"
        x, y = (begin[0] + end[0]) / 2.0, (begin[1] + end[1]) / 2.0
        if name == "z":
            canvas.text(x - 8, y, words, FAINT, "end", False)
        else:
            anchor = "start" if end[0] > begin[0] else "end"
            canvas.text(x + (12 if anchor == "start" else -12), y + 20, words, FAINT, anchor, False)
    for path in paths:
        places = seen(_fewer(path.points))
        canvas.line(places, path.colour, 1.6, path.is_dashed)
    (start,) = seen(paths[-1].points[0])
    canvas.box(start[0] - 3, start[1] - 3, 6, 6, paths[-1].colour, "here it began")
    canvas.text(start[0] + 7, start[1] + 4, "start", FAINT, "start", False)


def _draw_cube_edges(canvas: Canvas, seen: object, middle: Array, half: float, axis: int) -> None:
    assert callable(seen)
    others = [each for each in range(3) if each != axis]
    for first in (-half, half):
        for second in (-half, half):
            ends = np.array([middle, middle])
            ends[:, others[0]] += first
            ends[:, others[1]] += second
            ends[0, axis] -= half
            ends[1, axis] += half
            canvas.line(seen(ends), GRID, 1, False)


def _fewer(points: Array, most: int = 4000) -> Array:
    return points[:: -(-len(points) // most)]
