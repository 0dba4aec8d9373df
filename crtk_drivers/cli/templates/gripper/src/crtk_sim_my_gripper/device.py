"""The simulated gripper: what it understands, by the manual (the README)."""

from __future__ import annotations

from typing import Any

from crtk_sim_backends.kit import Fault, FaultKind
from crtk_sim_backends.kit.jaw import JAW_KINDS, Jaw, Met

WIDEST, SPEED, FORCE = 0.08, 0.6, 30.0
"""m, m/s, N."""
PERIOD = 0.005
"""Seconds from one step of the mechanics to the next."""
SILENCE = 0.2
"""Seconds without a line after which it stops."""

KINDS = {**JAW_KINDS, "deaf": FaultKind("deaf", "it understands nothing", lasting=True)}


class SimulatedGripper:
    """Two fingers, and perhaps something between them.

    Args:
        thing: its width, in m.
    """

    def __init__(self, thing: float) -> None:
        self.kinds = KINDS
        self._jaw = Jaw(WIDEST / 2.0, thing)
        self._velocity = self._silent_for = 0.0
        self._powered = self._holds = self._deaf = False
        self._target: float | None = None

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        self._deaf = not self._jaw.begin(fault) or self._deaf

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._deaf = self._jaw.end(fault) and self._deaf

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {**self._jaw.status, "powered": self._powered, "holds": self._holds}

    def obey(self, line: str) -> str | None:
        """Carry out one line of the host, and return the answer; None: there is none."""
        if self._deaf:
            return None
        self._silent_for = 0.0
        word, _, value = line.partition(" ")
        if word == "?":
            opening, speed = 1e3 * self._jaw.opening, 1e3 * self._velocity
            return f"G {opening:.3f} {speed:.2f} {self._powered:d} {self._holds:d}"
        if word in ("ON", "OFF"):
            self._powered = word == "ON"
        if word == "G" and self._powered:
            self._target = min(max(1e-3 * float(value), 0.0), WIDEST)
        elif word == "S" and not self._holds:
            self._target = None
        return None

    def advance(self) -> None:
        """Let one period pass."""
        self._silent_for += PERIOD
        if not self._powered or (self._silent_for > SILENCE and not self._holds):
            self._target = None
        before = self._jaw.opening
        met = None
        if self._target is not None:
            met = self._jaw.follow(self._target, SPEED, FORCE, PERIOD)
        self._holds = met is Met.OBJECT
        self._velocity = (self._jaw.opening - before) / PERIOD
