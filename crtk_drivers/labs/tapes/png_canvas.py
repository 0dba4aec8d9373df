"""A canvas that becomes a PNG file, by Pillow (the extra `plot`), with the font that comes with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from importlib import import_module
from io import BytesIO
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Final

from crtk_drivers.errors import MissingExtra
from crtk_drivers.labs.tapes.drawing import FAINT, GRID, INK, WIDTH, Points

FINER: Final = 2
"""Pixels that are drawn for one of the picture, in each direction: it is scaled down at the end."""

_COLOURS: Final[Mapping[str, str]] = MappingProxyType(
    {INK: "#1f2328", FAINT: "#59636e", GRID: "#e4e8ec"}
)
_ANCHORS: Final[Mapping[str, str]] = MappingProxyType({"start": "ls", "middle": "ms", "end": "rs"})
_DASH: Final = (5.0, 3.0)


class PngCanvas:
    """See `Canvas`; `png` is the file.

    Raises:
        MissingExtra: Pillow is not installed.
    """

    def __init__(self, height: float) -> None:
        try:
            image: Any = import_module("PIL.Image")
            draw: Any = import_module("PIL.ImageDraw")
            font: Any = import_module("PIL.ImageFont")
        except ImportError as error:
            raise MissingExtra("pillow", "plot") from error
        self._size = WIDTH, math.ceil(height)
        self._image = image.new("RGB", (FINER * WIDTH, FINER * self._size[1]), "#ffffff")
        self._draw = draw.Draw(self._image)
        self._plain = font.load_default(FINER * 11)
        self._bold = font.load_default(FINER * 14)
        self._smooth = image.Resampling.BOX

    @property
    def png(self) -> bytes:
        """What was drawn."""
        file = BytesIO()
        self._image.resize(self._size, self._smooth).save(file, "PNG")
        return file.getvalue()

    def line(self, points: Points, colour: str, width: float, is_dashed: bool) -> None:
        """See `Canvas`."""
        places = [(FINER * x, FINER * y) for x, y in points]
        parts = _dashes(places) if is_dashed else (places,)
        for part in parts:
            if len(part) > 1:
                self._draw.line(part, _rgb(colour), max(1, round(FINER * width)), "curve")

    def box(self, x: float, y: float, width: float, height: float, colour: str, hint: str) -> None:
        """See `Canvas`; the hint is not shown."""
        corners = (FINER * x, FINER * y, FINER * (x + width), FINER * (y + height))
        self._draw.rectangle(corners, _rgb(colour))

    def text(self, x: float, y: float, words: str, colour: str, anchor: str, is_bold: bool) -> None:
        """See `Canvas`."""
        font = self._bold if is_bold else self._plain
        place = FINER * x, FINER * y
        self._draw.text(place, words, _rgb(colour), font, _ANCHORS[anchor])


def _rgb(colour: str) -> str:
    return _COLOURS.get(colour, colour)


def _dashes(points: list[tuple[float, float]]) -> Iterator[list[tuple[float, float]]]:
    """Yield the dashes of a line through points."""
    lengths = tuple(FINER * each for each in _DASH)
    is_drawn, left = True, lengths[0]
    part = points[:1]
    for (x, y), (to_x, to_y) in pairwise(points):
        way = math.hypot(to_x - x, to_y - y)
        done = 0.0
        while way - done > left:
            done += left
            place = x + (to_x - x) * done / way, y + (to_y - y) * done / way
            if is_drawn:
                yield [*part, place]
            part = [place]
            is_drawn = not is_drawn
            left = lengths[0 if is_drawn else 1]
        left -= way - done
        if is_drawn:
            part.append((to_x, to_y))
    if is_drawn and len(part) > 1:
        yield part
