"""The sensor's protocol as values: bytes in, messages out. No port, no clock (see the README)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from crtk_drivers.kit import LineDecoder

ASK, TARE = b"?\n", b"T\n"
TARED = "OK"


@dataclass(frozen=True, slots=True)
class Force:
    """A measurement, in N."""

    force: float
    overload: bool


def decoder() -> LineDecoder[Force | str]:
    """Return what turns bytes, cut anywhere, into messages: `Force` and `TARED`."""
    return LineDecoder(parse)


def parse(line: str) -> Force | str:
    """Return the message of a line; it raises ValueError if it is damaged."""
    if line == TARED:
        return TARED
    kind, value, *rest = line.split(" ")
    force = float(value)
    if kind != "N" or rest not in ([], ["OVER"]) or not math.isfinite(force):
        raise ValueError("no measurement")
    return Force(force, bool(rest))
