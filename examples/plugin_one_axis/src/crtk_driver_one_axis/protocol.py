"""The stage's line protocol, as values: no socket, no clock (see the README for the protocol itself)."""

from __future__ import annotations

import math
from dataclasses import dataclass

LONGEST_LINE = 200
"""Bytes; more without an end of line is not this protocol."""


class BadLine(ValueError):
    """The stage sent something that its protocol does not allow."""


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


POWER_ON, POWER_OFF, STOP, KEEP_ALIVE = b"ON\n", b"OFF\n", b"S\n", b"K\n"


class Decoder:
    """Turns bytes, cut anywhere, into reports."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Report]:
        """Return the reports that `data` completes, oldest first.

        Raises:
            BadLine: with the line.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            raise BadLine(f"{len(self._rest)} bytes without an end of line")
        return [_report(line) for line in lines]


def _report(line: bytes) -> Report:
    try:
        kind, position, velocity, powered, *fault = line.decode("ascii").split(" ", 4)
        report = Report(float(position), float(velocity), powered == "1", "".join(fault))
    except ValueError as error:
        raise BadLine(repr(line)) from error
    if kind != "M" or not (math.isfinite(report.position) and math.isfinite(report.velocity)):
        raise BadLine(repr(line))
    return report
