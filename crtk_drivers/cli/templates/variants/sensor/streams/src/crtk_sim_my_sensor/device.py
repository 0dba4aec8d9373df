"""The simulated sensor: what lies on it, and what it understands, by the manual (the README)."""

from __future__ import annotations

import random
from typing import Any

from crtk_sim_backends.kit import Fault, FaultKind, Parameter

RANGE = 200.0
"""N; beyond it the sensor says so."""
NOISE = 0.002
"""N, standard deviation."""
PERIOD = 0.05
"""Seconds from one measurement to the next."""

KINDS = {
    kind.name: kind
    for kind in (
        FaultKind("load", "something lies on it", {"force": Parameter(float)}, lasting=True),
        FaultKind("deaf", "it says nothing", lasting=True),
    )
}


class SimulatedSensor:
    """A sensor.

    Args:
        load: what lies on it from the start, in N.
    """

    def __init__(self, load: float) -> None:
        self.kinds = KINDS
        self._random = random.Random(0)
        self._load = load
        self._added = 0.0
        self._zero = 0.0
        self._deaf = False
        self._streams = False

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        if fault.kind == "load":
            self._added = fault.parameters["force"]
        else:
            self._deaf = True

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "load":
            self._added = 0.0
        else:
            self._deaf = False

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {"load": self._load + self._added, "zero": self._zero}

    def obey(self, line: str) -> str | None:
        """Return the answer to a line of the host; None: there is none."""
        if self._deaf:
            return None
        if line == "S":
            self._streams = True
        if line == "T":
            self._zero = self._force()
            return "OK"
        return None

    def report(self) -> bytes:
        """Return the measurement that is sent now, empty: none."""
        if self._deaf or not self._streams:
            return b""
        force = self._force()
        over = " OVER" if abs(force) > RANGE else ""
        return f"N {force - self._zero:.4f}{over}\n".encode()

    def _force(self) -> float:
        return self._load + self._added + self._random.gauss(0.0, NOISE)
