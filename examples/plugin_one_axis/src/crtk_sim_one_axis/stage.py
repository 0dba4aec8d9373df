"""The simulated stage: its mechanics, and what it understands."""

from __future__ import annotations

from typing import Any

from crtk_sim_backends.kit import Fault, FaultKind

SPEED = 0.5
ACCELERATION = 2.0
GAIN = 25.0
"""1/s: how fast a position error is made up."""
SILENCE = 0.2
"""Seconds without a line after which the stage stops."""


KINDS = {"overload": FaultKind("overload", "the motor is overloaded", lasting=True)}


class Stage:
    """A carriage between two end stops. In m, m/s and s.

    Args:
        travel: where the far end stop is; the near one is at 0.

    Attributes:
        time: that has passed for it.
    """

    def __init__(self, travel: float) -> None:
        self.kinds = KINDS
        self.travel = travel
        self.time = 0.0
        self.position = travel / 2.0
        self.velocity = 0.0
        self.powered = False
        self.fault = ""
        self._target: float | None = None
        self._speed = 0.0
        self._silent_for = 0.0

    def begin(self, fault: Fault) -> None:
        """Fail: there is one kind only."""
        self.fault = "motor overload"

    def end(self, fault: Fault) -> None:
        """Be well again."""
        self.fault = ""

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {"position": self.position, "velocity": self.velocity, "powered": self.powered}

    def obey(self, line: str) -> None:
        """Carry out one line of the host."""
        self._silent_for = 0.0
        word, _, value = line.partition(" ")
        if word == "ON":
            self.powered = not self.fault
        elif word == "OFF":
            self.powered = False
        elif word == "S":
            self._target, self._speed = None, 0.0
        elif word == "P" and self.powered:
            self._target = min(max(float(value), 0.0), self.travel)
        elif word == "V" and self.powered:
            self._target, self._speed = None, float(value)

    def advance(self, step: float) -> None:
        """Let `step` seconds pass."""
        self.time += step
        self._silent_for += step
        if not self.powered or self.fault or self._silent_for > SILENCE:
            self._target, self._speed = None, 0.0
        wanted = self._speed if self._target is None else GAIN * (self._target - self.position)
        wanted = min(max(wanted, -SPEED), SPEED)
        change = ACCELERATION * step
        self.velocity += min(max(wanted - self.velocity, -change), change)
        self.position += self.velocity * step
        if not 0.0 <= self.position <= self.travel:
            self.position = min(max(self.position, 0.0), self.travel)
            self.velocity = 0.0

    def report(self) -> bytes:
        """Return the line that is sent to the host."""
        fault = f" {self.fault}" if self.fault else ""
        return f"M {self.position:.6f} {self.velocity:.6f} {self.powered:d}{fault}\n".encode()
