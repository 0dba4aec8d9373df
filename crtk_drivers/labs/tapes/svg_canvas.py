"""A canvas that becomes SVG in a page: it has the colours of the page, light or dark."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from types import MappingProxyType
from typing import Final

from crtk_drivers.labs.tapes.drawing import FAINT, GRID, INK, WIDTH, Points, draw, height_of
from crtk_drivers.labs.tapes.figures import Figures, figures_of_plot
from crtk_drivers.labs.verdicts.judging import Plot

_OF_PAGE: Final[Mapping[str, str]] = MappingProxyType(
    {INK: "var(--ink)", FAINT: "var(--faint)", GRID: "var(--line)"}
)


class SvgCanvas:
    """See `Canvas`; `svg` is the element.

    Args:
        height: in px.
        title: for who does not see it.
    """

    def __init__(self, height: float, title: str) -> None:
        self._height = height
        self._title = title
        self._parts: list[str] = []

    @property
    def svg(self) -> str:
        """What was drawn."""
        return (
            f'<svg viewBox="0 0 {WIDTH} {self._height:.0f}" style="max-width:{WIDTH}px" role="img" '
            f'xmlns="http://www.w3.org/2000/svg"><title>{escape(self._title)}</title>'
            f"{''.join(self._parts)}</svg>"
        )

    def line(self, points: Points, colour: str, width: float, is_dashed: bool) -> None:
        """See `Canvas`."""
        places = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        dashes = ";stroke-dasharray:5 3" if is_dashed else ""
        style = f"fill:none;stroke:{_css(colour)};stroke-width:{width:g}{dashes}"
        self._parts.append(f'<polyline points="{places}" style="{style}"/>')

    def box(self, x: float, y: float, width: float, height: float, colour: str, hint: str) -> None:
        """See `Canvas`."""
        told = f"<title>{escape(hint)}</title>" if hint else ""
        self._parts.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" '
            f'style="fill:{_css(colour)}">{told}</rect>'
        )

    def text(self, x: float, y: float, words: str, colour: str, anchor: str, is_bold: bool) -> None:
        """See `Canvas`."""
        font = "600 13px" if is_bold else "11px"
        style = f"font:{font} system-ui,sans-serif;fill:{_css(colour)};text-anchor:{anchor}"
        self._parts.append(f'<text x="{x:.1f}" y="{y:.1f}" style="{style}">{escape(words)}</text>')


def svg_of(figures: Figures, title: str) -> str:
    """Return figures as an SVG element."""
    canvas = SvgCanvas(height_of(figures), title)
    draw(canvas, figures, 0.0)
    return canvas.svg


def svg_of_plot(plot: Plot) -> str:
    """Return a plot as an SVG element. What is not finite, or beyond `LARGEST`, is left out."""
    return svg_of(figures_of_plot(plot), plot.title)


def _css(colour: str) -> str:
    return _OF_PAGE.get(colour, colour)
