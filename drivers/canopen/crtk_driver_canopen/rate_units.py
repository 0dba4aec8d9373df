"""From units of velocity and acceleration, as a drive reports them or its make has them, to SI. No I/O."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from crtk_driver_canopen.scale_keys import JointScale
from crtk_driver_canopen.unit_codes import ANGLES, COUNTS, LENGTHS, TURN, Rate

RATES: Final[Mapping[str, tuple[bool, float]]] = MappingProxyType(
    {
        "counts/s": (False, 1.0),
        "turns/s": (True, 1.0),
        "turns/min": (True, 1.0 / 60.0),
        "counts/s^2": (False, 1.0),
        "turns/s^2": (True, 1.0),
        "turns/min/s": (True, 1.0 / 60.0),
    }
)
"""Units of profiles: whether they are turns of the motor (else counts of 6064h), and how many a second."""


def motor_turns(joint: JointScale, gear: float | None) -> float | None:
    """Return turns of the motor for one rad (m) of the joint; None where nobody tells.

    Args:
        joint: its configuration.
        gear: that the drive reports.
    """
    if joint.scale is not None or (joint.kind == "prismatic" and joint.feed is None):
        return None
    return (joint.gear or gear or 1.0) / (joint.feed or TURN)


class MakeRate(Protocol):
    """What one unit is, by the profile of a make: so many of something in `RATES`."""

    @property
    def one(self) -> float: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102


class Transmission(NamedTuple):
    """What is between what a drive counts and its joint.

    Attributes:
        position: rad (m) of the joint for one position unit.
        turn: rad (m) of the joint for one turn behind the gear; None: not known.
        motor: turns of the motor for one of those.
        shaft: turns of what the drive takes for its shaft for one of those.
        of_shaft: angles that the drive reports are of its shaft, else of the motor.
        prismatic: the joint is.
    """

    position: float
    turn: float | None
    motor: float
    shaft: float
    of_shaft: bool
    prismatic: bool

    def reported(self, rate: Rate) -> float | None:
        """Return rad/s (m/s), or that a second, for a unit object; None where it does not fit the joint."""
        if rate.numerator in COUNTS:
            return rate.factor * self.position / rate.seconds
        if rate.numerator in LENGTHS:
            way = LENGTHS[rate.numerator] if self.prismatic else None
        else:
            turns = self.shaft if self.of_shaft else self.motor
            angle = ANGLES[rate.numerator] / TURN
            way = None if self.turn is None else angle * self.turn / turns
        return None if way is None else rate.factor * way / rate.seconds

    def of_make(self, rate: MakeRate) -> float | None:
        """Return the same for a unit of a make; None where it does not fit the joint."""
        of_motor, one = RATES[rate.unit]
        if not of_motor:
            return rate.one * self.position
        return None if self.turn is None else rate.one * one * self.turn / self.motor
