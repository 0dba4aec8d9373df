"""The simulated sensor: what lies on it, and what it understands, by the manual (the README)."""

from __future__ import annotations

import random
from typing import Any

from crtk_sim_backends.kit import Fault, FaultKind, Parameter

RANGE = 200.0
"""N; beyond it the sensor says so."""
NOISE = 0.002
"""N, standard deviation."""

KINDS = {
    kind.name: kind
    for kind in (
        FaultKind("load", "something lies on it", {"force": Parameter(float)}, lasting=True),
        FaultKind("deaf", "it answers nothing", lasting=True),
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
        force = self._load + self._added + self._random.gauss(0.0, NOISE)
        if line == "?":
            return f"N {force - self._zero:.4f}{' OVER' if abs(force) > RANGE else ''}"
        if line == "T":
            self._zero = force
            return "OK"
        return None
