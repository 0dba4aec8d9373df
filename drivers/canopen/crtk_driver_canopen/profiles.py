"""How fast each drive goes in a move that the drives plan themselves (profile position)."""

from __future__ import annotations

import math
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo
from crtk_driver_canopen.units import JointUnits

_U32: Final = 0xFFFFFFFF
_TINY: Final = 1e-12
"""rad/s² (m/s²): a joint that is not to move gets the longest ramp."""

_LEAST: Final = 1e-9
"""Share of the longest way below which a joint counts as being there."""

_SLOWEST: Final = 0.01
"""Part of its velocity that a joint keeps at least, so that it does not creep over its last counts."""

_HALVINGS: Final = 30


class ProfileRates(NamedTuple):
    """What a drive is given: profile velocity (6081), and acceleration and deceleration (6083, 6084)."""

    velocity: int
    acceleration: int

    @classmethod
    def of(
        cls,
        velocity: float,
        acceleration: float,
        unit: float,
        acceleration_unit: float | None = None,
        ramp_time: float | None = None,
    ) -> ProfileRates:
        """Return rates in the units of a drive, at least 1: a drive that is told 0 never arrives.

        Args:
            velocity: rad/s (m/s).
            acceleration: rad/s² (m/s²).
            unit: rad/s (m/s) for one velocity unit.
            acceleration_unit: rad/s² (m/s²) for one unit of acceleration; None: that of velocity a second.
            ramp_time: s for one unit where the drive takes the time in which it comes to its velocity; None:
                it takes accelerations.
        """
        ramps = (
            acceleration / abs(unit if acceleration_unit is None else acceleration_unit)
            if ramp_time is None
            else velocity / max(acceleration, _TINY) / ramp_time
        )
        velocities, accelerations = (
            min(max(1, round(min(rate, _U32))), _U32) for rate in (velocity / abs(unit), ramps)
        )
        return cls(velocities, accelerations)

    @classmethod
    def in_units(cls, velocity: float, acceleration: float, units: JointUnits) -> ProfileRates:
        """Return rates in the units of a joint; see `of`.

        An acceleration whose unit nobody tells is 0: such a drive makes no ramps, and is not given it.
        """
        rates = partial(cls.of, velocity, unit=units.velocity, ramp_time=units.ramp_time)
        if units.ramp_time is None and math.isnan(units.acceleration_step):
            return cls(rates(acceleration, acceleration_unit=1.0).velocity, 0)
        return rates(acceleration, acceleration_unit=units.acceleration)

    def write(self, sdo: Sdo, before: ProfileRates | None) -> None:
        """Write them into a drive.

        Args:
            sdo: of the axis.
            before: what it holds already; None: not known.

        Raises:
            SdoAborted, SdoSilent, ProtocolError: the drive does not take one.
        """
        if before is None or before.velocity != self.velocity:
            sdo.offer(OBJECTS["profile_velocity"], self.velocity)
        if before is None or before.acceleration != self.acceleration:
            sdo.offer(OBJECTS["profile_acceleration"], self.acceleration)
            sdo.offer(OBJECTS["profile_deceleration"], self.acceleration)


def shared_rates(
    distances: NDArray[np.float64],
    velocities: NDArray[np.float64],
    accelerations: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return velocities and accelerations (n,) with which all joints arrive at the same time.

    Each joint's share of the fastest that all of them allow is its share of the way: so the way is straight
    in joint space, as long as they begin together and at rest.

    Args:
        distances: (n,) from here to the goal, in rad (m).
        velocities: (n,) limits, in rad/s (m/s).
        accelerations: (n,) limits, in rad/s² (m/s²).
    """
    ways = np.abs(distances)
    longest = ways.max(initial=0.0)
    if not longest > 0.0:
        return velocities, accelerations
    shares = ways / longest
    moving = shares > _LEAST
    velocity = (velocities[moving] / shares[moving]).min()
    acceleration = (accelerations[moving] / shares[moving]).min()
    return velocity * shares, acceleration * shares


def arrival(distance: float, speed: float, velocity: float, acceleration: float) -> float:
    """Return the seconds in which a joint in motion comes to rest at its goal, on a trapezoidal profile.

    Args:
        distance: to the goal, in rad (m).
        speed: at which it moves now, in rad/s (m/s).
        velocity: at which it goes on, in rad/s (m/s), above 0.
        acceleration: up and down, in rad/s² (m/s²), above 0.
    """
    if distance < 0.0:
        distance, speed = -distance, -speed
    stopping = speed * abs(speed) / (2.0 * acceleration)
    if speed < 0.0 or stopping > distance:  # it comes to rest first, and goes from there
        rest = abs(speed) / acceleration
        return rest + arrival(abs(distance - stopping), 0.0, velocity, acceleration)
    peak = min(math.sqrt(acceleration * distance + 0.5 * speed * speed), velocity)
    ramps = abs(peak * peak - speed * speed) / (2.0 * acceleration)
    ramps += peak * peak / (2.0 * acceleration)
    at_peak = max(0.0, distance - ramps) / peak if peak else 0.0
    return (abs(peak - speed) + peak) / acceleration + at_peak


def velocities_from_motion(
    distances: NDArray[np.float64],
    speeds: NDArray[np.float64],
    velocities: NDArray[np.float64],
    accelerations: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return velocities (n,) with which joints in motion arrive with the one that takes longest.

    Args:
        distances: (n,) from here to the goal, in rad (m).
        speeds: (n,) at which they move now, in rad/s (m/s).
        velocities: (n,) limits, in rad/s (m/s).
        accelerations: (n,) that all of them keep, in rad/s² (m/s²); with less, one could go beyond its goal.
    """
    joints = list(
        zip(*(a.tolist() for a in (distances, speeds, velocities, accelerations)), strict=True)
    )
    longest = max((arrival(*joint) for joint in joints), default=0.0)
    found = []
    for distance, speed, limit, acceleration in joints:
        low, high = _SLOWEST * limit, limit
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if arrival(distance, speed, middle, acceleration) > longest:
                low = middle
            else:
                high = middle
        found.append(high)
    return np.array(found)
