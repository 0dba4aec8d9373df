"""Pictures as PNG files of at most 256 colours: of a page, a third of what a browser writes."""

from __future__ import annotations

import heapq
import struct
import zlib
from typing import Final

import numpy as np
from numpy.typing import NDArray

_COLOURS: Final = 256
_HEADER: Final = b"\x89PNG\r\n\x1a\n"
_PALETTE_TYPE: Final = 3


def encode(pixels: NDArray[np.uint8]) -> bytes:
    """Return a PNG file of pixels (height, width, 3): the colours, or the nearest to them."""
    height, width, _ = pixels.shape
    flat = pixels.reshape(-1, 3)
    exact, numbers, counts = np.unique(flat, axis=0, return_inverse=True, return_counts=True)
    palette, chosen = exact, np.arange(len(exact))
    if len(exact) > _COLOURS:
        palette, chosen = _reduce(exact, counts)
    rows = chosen[numbers.reshape(-1)].astype(np.uint8).reshape(height, width)
    data = np.pad(rows, ((0, 0), (1, 0))).tobytes()  # each row begins with its filter: none
    header = struct.pack(">IIBBBBB", width, height, 8, _PALETTE_TYPE, 0, 0, 0)
    chunks = (
        (b"IHDR", header),
        (b"PLTE", palette.astype(np.uint8).tobytes()),
        (b"IDAT", zlib.compress(data, 9)),
        (b"IEND", b""),
    )
    return _HEADER + b"".join(_chunk(name, body) for name, body in chunks)


def _reduce(
    exact: NDArray[np.uint8], counts: NDArray[np.int64]
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return a palette, and the number in it of each colour: the worst group is halved, again and again."""
    groups = [_rated(exact, counts, np.arange(len(exact)))]
    while len(groups) < _COLOURS:
        _, _, group = heapq.heappop(groups)
        axis = np.ptp(exact[group], axis=0).argmax()
        ordered = group[np.argsort(exact[group, axis], kind="stable")]
        share = np.cumsum(counts[ordered])
        half = min(max(1, int(np.searchsorted(share, share[-1] / 2))), len(ordered) - 1)
        for part in (ordered[:half], ordered[half:]):
            heapq.heappush(groups, _rated(exact, counts, part))
    chosen = np.empty(len(exact), np.int64)
    palette = np.empty((len(groups), 3))
    for number, (_, _, group) in enumerate(groups):
        chosen[group] = number
        palette[number] = np.average(exact[group], axis=0, weights=counts[group])
    return np.rint(palette).astype(np.uint8), chosen


def _rated(
    exact: NDArray[np.uint8], counts: NDArray[np.int64], group: NDArray[np.int64]
) -> tuple[float, int, NDArray[np.int64]]:
    """Return a group of colours as the heap has it: the worst first."""
    width = float(np.ptp(exact[group], axis=0).max())
    return -width * float(counts[group].sum()) ** 0.5, int(group[0]), group


def _chunk(name: bytes, body: bytes) -> bytes:
    check = zlib.crc32(name + body)
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", check)
