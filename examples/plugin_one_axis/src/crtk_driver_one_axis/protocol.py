"""The stage's line protocol, as values: no socket, no clock (see the README for the protocol itself)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from crtk_drivers.kit import LineDecoder

POWER_ON, POWER_OFF, STOP, KEEP_ALIVE = b"ON\n", b"OFF\n", b"S\n", b"K\n"


@dataclass(frozen=True, slots=True)
class Report:
    """What the stage says of itself a hundred times a second. In m and m/s."""

    position: float
    velocity: float
    powered: bool
    fault: str


def position_line(metres: float) -> bytes:
    """Return the command to go to a position."""
    return f"P {metres:.6f}\n".encode()


def velocity_line(metres_per_second: float) -> bytes:
    """Return the command to move at a velocity."""
    return f"V {metres_per_second:.6f}\n".encode()


def decoder() -> LineDecoder[Report]:
    """Return what turns bytes, cut anywhere, into reports."""
    return LineDecoder(parse_report)


def parse_report(line: str) -> Report:
    """Return the report of a line.

    Raises:
        ValueError: it is damaged.
    """
    kind, position, velocity, powered, *fault = line.split(" ", 4)
    report = Report(float(position), float(velocity), powered == "1", "".join(fault))
    if kind != "M" or not (math.isfinite(report.position) and math.isfinite(report.velocity)):
        raise ValueError("no report of a position and a velocity")
    return report
