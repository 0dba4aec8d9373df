"""The motor behind a drive, with its load, its switches and its stops."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

_BRAKE_TIME: Final = 0.02  # s in which the brake stops the motor from its rated speed
_RATED_SPEED: Final = 100 * math.pi  # rad/s: 3000 rpm
_AT_REST: Final = 1e-4  # rad/s


@dataclass(frozen=True)
class MotorConfig:
    """What a motor moves; positions in revolutions of the motor, torques at its shaft.

    Attributes:
        inertia: of motor and load, kg m².
        viscous: friction that grows with the speed, N·m s/rad.
        coulomb: friction that does not, N·m.
        gravity: constant torque of a hanging load, N·m.
        pendulum: torque of an arm that is horizontal at 0, N·m.
        gear: revolutions of the motor for one of that arm.
        brake: a holding brake closes when the motor has no power.
        negative_limit: negative limit switch, active below.
        positive_limit: positive limit switch, active above.
        home: the home switch is active between these two.
        stops: mechanical stops, beyond the limit switches.
        start: where the motor stands when the drive is switched on.
    """

    inertia: float = 1e-4
    viscous: float = 2e-4
    coulomb: float = 0.01
    gravity: float = 0.0
    pendulum: float = 0.0
    gear: float = 1.0
    brake: bool = True
    negative_limit: float = -100.0
    positive_limit: float = 100.0
    home: tuple[float, float] = (1.3, 2.1)
    stops: tuple[float, float] = (-102.0, 102.0)
    start: float = 0.0


class Motor:
    """A motor that turns: `position` in rad and `velocity` in rad/s at its shaft."""

    def __init__(self, config: MotorConfig) -> None:
        self.config = config
        self.position = 2 * math.pi * config.start
        self.velocity = 0.0
        self.stuck = False  # fault: does not turn whatever the torque
        self._stops = tuple(2 * math.pi * stop for stop in config.stops)

    @property
    def revolutions(self) -> float:
        """Position in revolutions."""
        return self.position / (2 * math.pi)

    @property
    def at_rest(self) -> bool:
        """Whether it stands and needs no computation while it has no power."""
        return self.velocity == 0.0 and self.config.brake

    def load(self) -> float:
        """Torque of the weight of the load, N·m, against positive motion."""
        config = self.config
        return config.gravity + config.pendulum * math.cos(self.position / config.gear)

    def step(self, torque: float, dt: float, *, powered: bool) -> None:
        """Advance by `dt` seconds under the `torque` of the drive, N·m."""
        if self.stuck:
            self.velocity = 0.0
            return
        config = self.config
        if not powered and config.brake:
            change = _RATED_SPEED / _BRAKE_TIME * dt
            self.velocity = math.copysign(max(0.0, abs(self.velocity) - change), self.velocity)
        else:
            drive = torque - self.load() - config.viscous * self.velocity
            if abs(self.velocity) < _AT_REST and abs(drive) <= config.coulomb:
                self.velocity = 0.0
            else:
                self.velocity += self._acceleration(drive, dt) * dt
        self.position += self.velocity * dt
        low, high = self._stops
        if not low <= self.position <= high:
            self.position = min(max(self.position, low), high)
            self.velocity = 0.0

    def _acceleration(self, drive: float, dt: float) -> float:
        """Acceleration with dry friction, which stops the motor but never drives it, rad/s²."""
        config = self.config
        free = self.velocity + drive / config.inertia * dt
        dry = config.coulomb / config.inertia * dt
        slowed = math.copysign(max(0.0, abs(free) - dry), free)
        return (slowed - self.velocity) / dt

    # Switches, by revolutions

    @property
    def negative_limit(self) -> bool:
        """Negative limit switch."""
        return self.revolutions <= self.config.negative_limit

    @property
    def positive_limit(self) -> bool:
        """Positive limit switch."""
        return self.revolutions >= self.config.positive_limit

    @property
    def home(self) -> bool:
        """Home switch."""
        low, high = self.config.home
        return low <= self.revolutions <= high
