"""A picture of what a calibration left over: one group of bars for each pose, forces above, torques below."""

from __future__ import annotations

from typing import Final
from xml.sax.saxutils import escape

import numpy as np

from crtk_driver_ati_netft.compensation import ToolFit
from crtk_drivers.samples import Array

WIDTH: Final = 800
PANEL: Final = 180
MARGIN: Final = 96
MOST_NAMED: Final = 12
"""Poses below whose bars there is room for more than a number."""
COLORS: Final = ("#d55e00", "#009e73", "#0072b2")
"""That people who see few colours can tell apart, too (Okabe and Ito)."""


def residual_plot(fit: ToolFit, title: str) -> str:
    """Return an SVG of the residuals of `fit`, each panel scaled to its largest."""
    height = 2 * PANEL + 3 * MARGIN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" '
        f'viewBox="0 0 {WIDTH} {height}" font-family="sans-serif" font-size="12">',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
        f'<text x="{MARGIN}" y="36" font-size="14">{escape(title)}</text>',
        *_panel(fit.residuals[:, :3], MARGIN, "N", ("Fx", "Fy", "Fz")),
        *_panel(fit.residuals[:, 3:], 2 * MARGIN + PANEL, "N·m", ("Tx", "Ty", "Tz")),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _panel(values: Array, top: float, unit: str, axes: tuple[str, str, str]) -> list[str]:
    most = float(np.abs(values).max()) or 1.0
    middle, scale = top + PANEL / 2, PANEL / 2 / most
    group = (WIDTH - 2 * MARGIN) / len(values)
    bar = group / 4
    parts = [
        f'<line x1="{MARGIN}" x2="{WIDTH - MARGIN}" y1="{y:.1f}" y2="{y:.1f}" stroke="#999"/>'
        f'<text x="{MARGIN - 6}" y="{y + 4:.1f}" text-anchor="end">{label}</text>'
        for y, label in (
            (top, f"{most:.2g} {unit}"),
            (middle, "0"),
            (top + PANEL, f"-{most:.2g}"),
        )
    ]
    for axis, (name, color) in enumerate(zip(axes, COLORS, strict=True)):
        legend = WIDTH - MARGIN - 40 * (3 - axis)
        parts.append(f'<text x="{legend}" y="{top - 8}" fill="{color}">{name}</text>')
    word = "pose " if len(values) <= MOST_NAMED else ""
    for pose, row in enumerate(values.tolist()):
        left = MARGIN + pose * group
        center = left + group / 2
        parts.append(
            f'<text x="{center:.1f}" y="{top + PANEL + 16:.1f}" text-anchor="middle">'
            f"{word}{pose + 1}</text>"
        )
        for axis, value in enumerate(row):
            x, size = left + bar / 2 + axis * bar, abs(value) * scale
            y = middle - size if value > 0.0 else middle
            parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{bar:.1f}" height="{size:.1f}" '
                f'fill="{COLORS[axis]}"/>'
            )
    return parts
