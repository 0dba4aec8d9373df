"""Finger kinematics: from the angle of a gripper's servo to the opening of its fingers, and back.

An opening is what ``gripper/measured_js`` holds: the clear distance between the fingers in m, or the angle of
a jaw in rad. Efforts follow from virtual work: a torque of the servo, divided by d opening / d angle, is the
effort on the opening, which for two fingers that close on each other is the force of each.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from typing_extensions import override

from crtk_drivers.errors import ConfigError

_ROUNDING = 1e-12


class Finger(ABC):
    """How an opening depends on the servo's angle (rad, at the horn, after sign, gear and offset)."""

    @abstractmethod
    def opening(self, angle: float) -> float:
        """Return the opening at an angle of the servo."""

    @abstractmethod
    def angle(self, opening: float) -> float:
        """Return the angle of the servo at an opening.

        Raises:
            ConfigError: the fingers cannot be there.
        """

    @abstractmethod
    def rate(self, angle: float) -> float:
        """Return d opening / d angle: the opening's velocity for 1 rad/s of the servo."""

    def state(self, angle: float, velocity: float, torque: float) -> tuple[float, float, float]:
        """Return opening, velocity and effort for those of the servo."""
        rate = self.rate(angle)
        return self.opening(angle), rate * velocity, self.effort(torque, angle)

    def effort(self, torque: float, angle: float) -> float:
        """Return the effort on the opening (N or N·m) of a torque of the servo; inf where it has no lever."""
        rate = self.rate(angle)
        return torque / rate if rate else math.copysign(math.inf, torque) if torque else 0.0

    def torque(self, effort: float, angle: float) -> float:
        """Return the servo's torque in N·m for an effort on the opening."""
        return effort * self.rate(angle)


@dataclass(frozen=True, slots=True)
class SliderCrank(Finger):
    """Two fingers on a rail, each pushed by a rod from one side of the servo's horn.

    At angle 0 the horn stands across the rail; a finger's distance from the servo's axis is
    ``x = horn * sin(angle) + sqrt(rod² - horn² * cos(angle)²)``, and the opening ``2 * x - gap``.

    Attributes:
        horn: from the servo's axis to the pin of the rod, in m.
        rod: between its pins, in m; longer than the horn.
        gap: what lies between the fingers' carriers when their pads touch, in m.

    Raises:
        ConfigError: not longer than the horn, or not above zero.
    """

    horn: float
    rod: float
    gap: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.horn < self.rod < math.inf:
            raise ConfigError(
                f"a horn of {self.horn:g} m with a rod of {self.rod:g} m cannot push a finger",
                remedy="Measure both between their pins: the rod is longer than the horn.",
            )

    @override
    def opening(self, angle: float) -> float:
        across = self.horn * math.cos(angle)
        return 2.0 * (self.horn * math.sin(angle) + math.sqrt(self.rod**2 - across**2)) - self.gap

    @override
    def angle(self, opening: float) -> float:
        """The result is within ±pi/2, where the opening grows with the angle."""
        distance = 0.5 * (opening + self.gap)
        if distance > 0.0:
            # law of cosines in the triangle of axis and both pins of the rod
            sine = (self.horn**2 + distance**2 - self.rod**2) / (2.0 * self.horn * distance)
            if abs(sine) <= 1.0 + _ROUNDING:
                return math.asin(min(1.0, max(-1.0, sine)))
        least = 2.0 * (self.rod - self.horn) - self.gap
        most = 2.0 * (self.rod + self.horn) - self.gap
        raise ConfigError(
            f"an opening of {opening:g} m cannot be reached",
            remedy=f"With this horn, rod and gap it is from {least:.4g} to {most:.4g} m.",
        )

    @override
    def rate(self, angle: float) -> float:
        across = self.horn * math.cos(angle)
        along = self.horn * math.sin(angle)
        return 2.0 * across * (1.0 + along / math.sqrt(self.rod**2 - across**2))


@dataclass(frozen=True, slots=True)
class Linear(Finger):
    """Fingers on racks or screws: the opening is proportional to the angle.

    Attributes:
        travel: of the opening for one radian of the servo, in m: twice the pinion's radius where both
            fingers move.
        gap: opening at angle 0, in m.

    Raises:
        ConfigError: no travel.
    """

    travel: float
    gap: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.travel) and self.travel):
            raise ConfigError(
                f"a travel of {self.travel:g} m",
                remedy="Give the change of the opening for one radian of the servo.",
            )

    @override
    def opening(self, angle: float) -> float:
        return self.travel * angle + self.gap

    @override
    def angle(self, opening: float) -> float:
        return (opening - self.gap) / self.travel

    @override
    def rate(self, angle: float) -> float:
        return self.travel


@dataclass(frozen=True, slots=True)
class Jaw(Finger):
    """A jaw that turns with the servo: its opening is the servo's angle, in rad."""

    @override
    def opening(self, angle: float) -> float:
        return angle

    @override
    def angle(self, opening: float) -> float:
        return opening

    @override
    def rate(self, angle: float) -> float:
        return 1.0
