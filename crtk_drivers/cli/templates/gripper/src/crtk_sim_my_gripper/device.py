"""The simulated gripper: its mechanics, and what it understands, by the manual (the README)."""

from __future__ import annotations

from typing import Any

from crtk_sim_backends.kit import Fault, FaultKind, Parameter

WIDEST, SPEED, ACCELERATION = 0.08, 0.6, 4.0
"""m, m/s, m/s²."""
GAIN = 40.0
"""1/s: how fast an error of the opening is made up."""
PERIOD = 0.005
"""Seconds from one step of the mechanics to the next."""
SILENCE = 0.2
"""Seconds without a line after which it stops."""

KINDS = {
    kind.name: kind
    for kind in (
        FaultKind("thing", "something is put in", {"width": Parameter(float)}, lasting=True),
        FaultKind("deaf", "it understands nothing", lasting=True),
    )
}


class SimulatedGripper:
    """Two fingers, and perhaps something between them.

    Args:
        thing: its width, in m.
    """

    def __init__(self, thing: float) -> None:
        self.kinds = KINDS
        self._thing = thing
        self._opening = WIDEST / 2.0
        self._velocity = 0.0
        self._powered = False
        self._target: float | None = None
        self._silent_for = 0.0
        self._deaf = False

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        if fault.kind == "thing":
            self._thing = fault.parameters["width"]
        else:
            self._deaf = True

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "thing":
            self._thing = 0.0
        else:
            self._deaf = False

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {"opening": self._opening, "powered": self._powered, "holds": self._holds}

    def obey(self, line: str) -> str | None:
        """Carry out one line of the host, and return the answer; None: there is none."""
        if self._deaf:
            return None
        self._silent_for = 0.0
        word, _, value = line.partition(" ")
        if word == "?":
            opening, speed = 1e3 * self._opening, 1e3 * self._velocity
            return f"G {opening:.3f} {speed:.2f} {self._powered:d} {self._holds:d}"
        if word in ("ON", "OFF"):
            self._powered = word == "ON"
        if word == "G" and self._powered:
            self._target = 1e-3 * float(value)
        elif word == "S":
            self._target = None
        return None

    def advance(self) -> None:
        """Let one period pass."""
        self._silent_for += PERIOD
        if not self._powered or self._silent_for > SILENCE:
            self._target = None
        wanted = 0.0 if self._target is None else GAIN * (self._target - self._opening)
        change = min(max(wanted, -SPEED), SPEED) - self._velocity
        most = ACCELERATION * PERIOD
        self._velocity += min(max(change, -most), most)
        opening = self._opening + self._velocity * PERIOD
        self._opening = min(max(opening, self._thing), WIDEST)
        if self._opening != opening:
            self._velocity = 0.0

    @property
    def _holds(self) -> bool:
        pressed = self._target is not None and self._target < self._thing
        return pressed and self._opening <= self._thing
