"""The simulated scale: what lies on it, and what it understands, by the manual (the README)."""

from __future__ import annotations

from typing import Any

from crtk_sim_backends.kit import Fault, FaultKind, Parameter

RANGE = 2000.0
"""g; beyond it, and below zero by more than that, it weighs nothing."""

KINDS = {
    kind.name: kind
    for kind in (
        FaultKind("load", "something lies on it", {"mass": Parameter(float)}, lasting=True),
        FaultKind("shaken", "it is not at rest", lasting=True),
        FaultKind("other_unit", "somebody has set it to kg", lasting=True),
        FaultKind("deaf", "it answers nothing", lasting=True),
    )
}


class Scale:
    """A scale.

    Args:
        mass: what lies on it from the start, in g.
    """

    def __init__(self, mass: float) -> None:
        self.kinds = KINDS
        self._mass = mass
        self._zero = 0.0
        self._faults: dict[str, Fault] = {}

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        self._faults[fault.kind] = fault

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._faults.pop(fault.kind, None)

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {"mass": self._on_it, "zero": self._zero}

    @property
    def _on_it(self) -> float:
        load = self._faults.get("load")
        return self._mass + (load.parameters["mass"] if load else 0.0)

    def obey(self, line: str) -> str | None:
        """Return the answer to a line of the host; None: there is none."""
        at_rest = "shaken" not in self._faults
        if "deaf" in self._faults:
            return None
        if line == "\x1bT" and at_rest:
            self._zero = self._on_it
        return self._weighed(at_rest) if line == "\x1bP" else None

    def _weighed(self, at_rest: bool) -> str:
        if abs(self._on_it) > RANGE:
            return f"{'High' if self._on_it > 0.0 else 'Low':^14}"
        factor, unit, decimals = (1e-3, "kg", 5) if "other_unit" in self._faults else (1.0, "g", 2)
        value = factor * (self._on_it - self._zero)
        sign = "-" if value < 0.0 else "+"
        return f"{sign} {abs(value):8.{decimals}f} {unit if at_rest else '':3}"
