"""How fast each drive goes in a move that the drives plan themselves (profile position)."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import Sdo

__all__ = ["ProfileRates", "shared_rates"]

_U32: Final = 0xFFFFFFFF

_LEAST: Final = 1e-9
"""Share of the longest way below which a joint counts as being there."""


class ProfileRates(NamedTuple):
    """What a drive is given: profile velocity (6081), and acceleration and deceleration (6083, 6084)."""

    velocity: int
    acceleration: int

    @classmethod
    def of(cls, velocity: float, acceleration: float, unit: float) -> ProfileRates:
        """Return rates in the units of a drive, at least 1: a drive that is told 0 never arrives.

        Args:
            velocity: rad/s (m/s).
            acceleration: rad/s² (m/s²).
            unit: rad/s (m/s) for one velocity unit; accelerations count in that a second.
        """
        velocities, accelerations = (
            min(max(1, round(rate / abs(unit))), _U32) for rate in (velocity, acceleration)
        )
        return cls(velocities, accelerations)

    def write(self, sdo: Sdo, before: ProfileRates | None) -> None:
        """Write them into a drive.

        Args:
            sdo: of the axis.
            before: what it holds already; None: not known.

        Raises:
            SdoAborted, SdoSilent, ProtocolError: the drive does not take one.
        """
        if before is None or before.velocity != self.velocity:
            sdo.write(OBJECTS["profile_velocity"], self.velocity)
        if before is None or before.acceleration != self.acceleration:
            sdo.write(OBJECTS["profile_acceleration"], self.acceleration)
            sdo.write(OBJECTS["profile_deceleration"], self.acceleration)


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
