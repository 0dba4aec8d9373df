"""Plots as SVG, drawn by us: nothing is loaded, and ten thousand points are some kilobytes."""

from __future__ import annotations

import math
from html import escape
from typing import Final

import numpy as np

from crtk_drivers.labs.verdicts.judging import Plot, Series, number

WIDTH: Final = 720
HEIGHT: Final = 250
LEFT, RIGHT, TOP, BOTTOM = 64, 12, 40, 40
LARGEST: Final = 1e100
"""Beyond it, as where it is not finite, a value is left out."""

COLUMNS: Final = 600
"""Of a line with more points, the least and the greatest of each of so many columns are drawn."""

COLOURS: Final = ("#1f6feb", "#d1570c", "#1a7f37", "#8250df", "#bf3989", "#57606a", "#9a6700")


def svg(plot: Plot) -> str:
    """Return a plot as an SVG element. Values that are not finite, or beyond `LARGEST`, are left out."""
    lines = [(series.name, *_thinned(series)) for series in plot.series]
    xs = np.concatenate([x for _, x, _ in lines]) if lines else np.empty(0)
    ys = np.concatenate([y for _, _, y in lines]) if lines else np.empty(0)
    x_low, x_high = _range(xs)
    y_low, y_high = _range(ys)

    def at_x(value: float) -> float:
        return LEFT + (value - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT)

    def at_y(value: float) -> float:
        return HEIGHT - BOTTOM - (value - y_low) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM)

    parts = [
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" xmlns="http://www.w3.org/2000/svg">',
        f"<title>{escape(plot.title)}</title>",
        f'<text x="{LEFT}" y="14" class="t">{escape(plot.title)}</text>',
    ]
    for tick in _ticks(y_low, y_high):
        y = at_y(tick)
        parts.append(f'<path d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}" class="g"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" class="a e">{number(tick)}</text>')
    for tick in _ticks(x_low, x_high):
        x = at_x(tick)
        parts.append(f'<path d="M{x:.1f} {TOP}V{HEIGHT - BOTTOM}" class="g"/>')
        parts.append(
            f'<text x="{x:.1f}" y="{HEIGHT - BOTTOM + 14}" class="a m">{number(tick)}</text>'
        )
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(
        f'<text x="{middle:.0f}" y="{HEIGHT - 8}" class="a m">{escape(plot.x_label)}</text>'
    )
    parts.append(
        f'<text transform="translate(12 {(TOP + HEIGHT - BOTTOM) / 2:.0f}) rotate(-90)" class="a m">'
        f"{escape(plot.y_label)}</text>"
    )
    legend = LEFT
    for index, (name, x_values, y_values) in enumerate(lines):
        colour = COLOURS[index % len(COLOURS)]
        points = " ".join(
            f"{at_x(x):.1f},{at_y(y):.1f}" for x, y in zip(x_values, y_values, strict=True)
        )
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}"/>')
        if name:
            style = f'class="a" style="fill:{colour}"'
            parts.append(f'<text x="{legend}" y="30" {style}>{escape(name)}</text>')
            legend += 6 * len(name) + 14
    parts.append("</svg>")
    return "".join(parts)


def _thinned(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Return the points that can be drawn, at most two a column."""
    x, y = np.asarray(series.x, dtype=float), np.asarray(series.y, dtype=float)
    sound = (np.abs(x) < LARGEST) & (np.abs(y) < LARGEST)
    x, y = x[sound], y[sound]
    if x.size <= 2 * COLUMNS:
        return x, y
    kept: list[int] = []
    for part in np.array_split(np.arange(x.size), COLUMNS):
        ends = {int(part[np.argmin(y[part])]), int(part[np.argmax(y[part])])}
        kept.extend(sorted(ends))
    return x[kept], y[kept]


def _range(values: np.ndarray) -> tuple[float, float]:
    if values.size == 0:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if high - low > 1e-12 * max(1.0, abs(high), abs(low)):
        return low, high
    room = 0.5 * abs(high) or 0.5
    return low - room, high + room


def _ticks(low: float, high: float) -> list[float]:
    """Return about five round values of a range."""
    rough = (high - low) / 5.0
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= rough)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [0.0 if index == 0 else index * step for index in range(first, last + 1)]
