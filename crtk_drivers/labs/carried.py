"""What hangs on a sensor that an arm carries, and how its weight pulls as the arm turns.

The weight alone: what accelerates the tool, and what touches it, is in none of this.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import Vector, Wrench, vector

GRAVITY: Final = 9.80665
"""m/s², against the z axis of the frame in which the arm tells its poses."""


@dataclass(frozen=True)
class Carried:
    """A sensor on an arm, and its tool.

    Attributes:
        mass: of the tool, in kg; 0 where it is not known.
        center_of_mass: of the tool, in the sensor's frame, in m.
        orientation: of the sensor in the frame of the arm's ``measured_cp``: quaternion x, y, z, w.
    """

    mass: float = 0.0
    center_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def down(self, arm: Vector) -> Vector:
        """Return the direction of gravity (3,) in the sensor's frame.

        Args:
            arm: orientation (4,) that the arm tells.
        """
        sensor = matrix_from_quaternion(arm) @ matrix_from_quaternion(vector(self.orientation))
        return vector(-sensor[2])

    def weight(self, arm: Vector) -> Wrench:
        """Return what the tool pulls with at an orientation (4,) of the arm, in the sensor's frame."""
        force = self.mass * GRAVITY * self.down(arm)
        return Wrench(vector(force), vector(np.cross(self.center_of_mass, force)))


UNKNOWN: Final = Carried()
"""As nothing is said of: the axes of the arm's tool, and no tool that is known."""
