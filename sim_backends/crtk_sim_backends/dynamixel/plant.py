"""The mechanics: joints with inertia, gravity and friction, turned by one motor or by several.

A joint advances lazily, when somebody asks for it; at rest that costs nothing. The motor is the usual
straight line between stall and no-load speed; what the firmware makes of goals is in
`crtk_sim_backends.dynamixel.drive`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Protocol

STEP: Final = 0.004  # s, the longest that the mechanics are integrated at once
LONGEST: Final = 10.0  # s that are integrated in one go; after that it turns on as it does then

_STALL_ACCELERATION: Final = (
    120.0  # rad/s² of the joint without gravity, by which its inertia is chosen
)
_FRICTION: Final = 0.02  # of the stall torque
_STANDSTILL: Final = 1e-6  # rad/s


class Actuator(Protocol):
    """What turns a joint."""

    def torque(self, angle: float, velocity: float, load: float, time: float) -> float:
        """Torque on the joint, N·m; `load` is what gravity and others apply, `time` is that of the plant."""

    @property
    def settled(self) -> bool:
        """Whether the torque cannot change while the joint stands still and nobody writes."""

    deadline: float
    """The next moment at which it changes by itself; infinity if none."""

    def reach(self, time: float) -> None:
        """Do what is due at `time`."""


@dataclass(eq=False)
class Joint:
    """One axis.

    Attributes:
        stall: sum of the stall torques of its motors, N·m.
        gravity: torque of gravity at a quarter turn from upright (angle 0), N·m.
        angle: rad; velocity: rad/s; acceleration: rad/s².
        push: external torque, N·m.
        stuck: it cannot turn.
    """

    stall: float
    gravity: float = 0.0
    angle: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0
    push: float = 0.0
    stuck: bool = False
    time: float = 0.0

    def __post_init__(self) -> None:
        self.actuators: list[Actuator] = []
        self._asleep = False
        self.add_motor(0.0)

    def add_motor(self, stall: float) -> None:
        """Let another motor turn it too; the inertia is one that suits them."""
        self.stall += stall
        self.inertia = self.stall / _STALL_ACCELERATION + self.gravity / 40.0

    @property
    def friction(self) -> float:
        """Torque against every motion, N·m."""
        return _FRICTION * self.stall

    def wake(self) -> None:
        """Something has changed: the next `advance` integrates again."""
        self._asleep = False

    def load(self) -> float:
        """Torque of gravity and of others, N·m."""
        return self.gravity * math.sin(self.angle) + self.push

    def advance(self, time: float) -> None:
        """Go on to `time` of the plant, s."""
        if time <= self.time:
            return
        while self.time < time:
            until = time
            for actuator in self.actuators:
                if actuator.deadline < until:
                    until = max(self.time, actuator.deadline)
            self._integrate(until)
            for actuator in self.actuators:
                if actuator.deadline <= until:
                    actuator.reach(until)

    def _integrate(self, until: float) -> None:
        if self._asleep:
            self.time = until
            return
        end = min(until, self.time + LONGEST)
        while self.time < end and not self._asleep:
            step = min(STEP, end - self.time)
            self.time += step
            self._step(step)
        self.angle += self.velocity * max(0.0, until - self.time)
        self.time = until

    def _step(self, step: float) -> None:
        load = self.load()
        torque = load
        for actuator in self.actuators:
            torque += actuator.torque(self.angle, self.velocity, load, self.time)
        before, inertia = self.velocity, self.inertia
        if self.stuck:
            self.velocity = 0.0
        else:
            velocity = before + torque * step / inertia
            held = self.friction * step / inertia
            if abs(velocity) <= held:
                velocity = 0.0
            else:
                velocity -= math.copysign(held, velocity)
            self.angle += 0.5 * (before + velocity) * step
            self.velocity = velocity
        self.acceleration = (self.velocity - before) / step
        if abs(self.velocity) < _STANDSTILL and abs(before) < _STANDSTILL:
            self.velocity = 0.0
            self._asleep = all(actuator.settled for actuator in self.actuators)
