"""The arm's protocol as values: bytes in, messages out. No socket, no clock (see the README)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from crtk_drivers.kit import LineDecoder

JOINTS = ("base", "shoulder", "elbow")

POWER_ON, POWER_OFF, STOP, KEEP_ALIVE = b"ON\n", b"OFF\n", b"S\n", b"K\n"


@dataclass(frozen=True, slots=True)
class Report:
    """What the arm says of itself, in rad and rad/s."""

    position: tuple[float, ...]
    velocity: tuple[float, ...]
    powered: bool
    fault: str


def position_line(position: Iterable[float]) -> bytes:
    """Return the command to go to a position, in rad."""
    return f"P {' '.join(f'{value:.6f}' for value in position)}\n".encode()


def velocity_line(velocity: Iterable[float]) -> bytes:
    """Return the command to move at a velocity, in rad/s."""
    return f"V {' '.join(f'{value:.6f}' for value in velocity)}\n".encode()


def decoder() -> LineDecoder[Report]:
    """Return what turns bytes, cut anywhere, into reports."""
    return LineDecoder(parse)


def parse(line: str) -> Report:
    """Return the report of a line; it raises ValueError if it is none."""
    count = len(JOINTS)
    kind, *words = line.split(" ", 2 + 2 * count)
    values = tuple(map(float, words[: 2 * count]))
    powered, *fault = words[2 * count :] or ("",)
    if kind != "M" or powered not in ("0", "1") or not all(map(math.isfinite, values)):
        raise ValueError("no report of positions, velocities and power")
    return Report(values[:count], values[count:], powered == "1", "".join(fault))
