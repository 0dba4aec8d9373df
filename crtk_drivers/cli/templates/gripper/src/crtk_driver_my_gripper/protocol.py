"""The gripper's protocol as values: bytes in, messages out. No port, no clock (see the README)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from crtk_drivers.kit import LineDecoder

ASK, POWER_ON, STOP = b"?\n", b"ON\n", b"S\n"


@dataclass(frozen=True, slots=True)
class Report:
    """What the gripper says of itself, in m and m/s."""

    opening: float
    velocity: float
    powered: bool
    holds: bool


def opening_line(metres: float) -> bytes:
    """Return the command to go to an opening."""
    return f"G {1e3 * metres:.2f}\n".encode()


def decoder() -> LineDecoder[Report]:
    """Return what turns bytes, cut anywhere, into reports."""
    return LineDecoder(parse)


def parse(line: str) -> Report:
    """Return the report of a line; it raises ValueError if it is none."""
    kind, opening, velocity, powered, holds = line.split(" ")
    report = Report(1e-3 * float(opening), 1e-3 * float(velocity), powered == "1", holds == "1")
    if kind != "G" or not (math.isfinite(report.opening) and math.isfinite(report.velocity)):
        raise ValueError("no report of an opening")
    return report
