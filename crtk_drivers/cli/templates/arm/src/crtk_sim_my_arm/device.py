"""The simulated arm: its mechanics, and what it understands, by the manual (the README)."""

from __future__ import annotations

from typing import Any

from crtk_sim_backends.kit import Fault, FaultKind

COUNT = 3
RANGE, SPEED, ACCELERATION = 2.1, 3.5, 12.0
"""rad to both sides, rad/s, rad/s²."""
GAIN = 25.0
"""1/s: how fast a position error is made up."""
PERIOD = 0.01
"""Seconds from one report to the next."""
SILENCE = 0.2
"""Seconds without a line after which it stops."""

KINDS = {"overload": FaultKind("overload", "a motor is overloaded", lasting=True)}


class SimulatedArm:
    """Three joints that know nothing of one another."""

    def __init__(self) -> None:
        self.kinds = KINDS
        self._position = [0.0] * COUNT
        self._velocity = [0.0] * COUNT
        self._powered = False
        self._fault = ""
        self._targets: list[float] | None = None
        self._speeds = [0.0] * COUNT
        self._silent_for = 0.0

    def begin(self, fault: Fault) -> None:
        """Fail: there is one kind only."""
        self._fault = "motor overload"

    def end(self, fault: Fault) -> None:
        """Be well again."""
        self._fault = ""

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {"position": self._position, "powered": self._powered}

    def obey(self, line: str) -> None:
        """Carry out one line of the host."""
        self._silent_for = 0.0
        word, *values = line.split()
        if word == "ON":
            self._powered = not self._fault
        elif word == "OFF":
            self._powered = False
        elif word == "S":
            self._hold()
        elif word in ("P", "V") and self._powered and len(values) == COUNT:
            numbers = [float(value) for value in values]
            self._targets = numbers if word == "P" else None
            self._speeds = numbers if word == "V" else [0.0] * COUNT

    def advance(self) -> None:
        """Let one period pass."""
        self._silent_for += PERIOD
        if not self._powered or self._fault or self._silent_for > SILENCE:
            self._hold()
        for joint in range(COUNT):
            wanted = self._speeds[joint]
            if self._targets is not None:
                wanted = GAIN * (self._targets[joint] - self._position[joint])
            change = min(max(wanted, -SPEED), SPEED) - self._velocity[joint]
            most = ACCELERATION * PERIOD
            self._velocity[joint] += min(max(change, -most), most)
            position = self._position[joint] + self._velocity[joint] * PERIOD
            self._position[joint] = min(max(position, -RANGE), RANGE)
            if abs(position) > RANGE:
                self._velocity[joint] = 0.0

    def report(self) -> bytes:
        """Return the line that is sent to the host."""
        numbers = " ".join(f"{value:.6f}" for value in (*self._position, *self._velocity))
        fault = f" {self._fault}" if self._fault else ""
        return f"M {numbers} {self._powered:d}{fault}\n".encode()

    def _hold(self) -> None:
        self._targets, self._speeds = None, [0.0] * COUNT
