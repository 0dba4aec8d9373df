"""Efforts through voltages: what a motor does that controls no current. Pure.

A motor at a duty d (of the voltage V) that turns with w exerts about ``stall * (d * V / V0 - w / w0)``: the
straight line between its stall torque and its no-load speed w0, both at V0 (e-manual, "Performance Graph").
That is an estimate, good to some 20 %: friction in the gears, the temperature of the windings and the spread
of the models are not in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_driver_dynamixel.units import Servo
from crtk_drivers.samples import Vector, vector

MADE_UP: Final = 0.9
"""Of the voltage that a turning motor induces: all of it, by a speed from the cycle before, could keep a
joint turning that nothing drives."""


@dataclass(frozen=True, slots=True, eq=False)
class Motors:
    """The motors of some servos, as their joints see them.

    Attributes:
        stall: (servos,) N·m.
        speed: (servos,) rad/s without load.
        voltage: (servos,) V at which both hold.
    """

    stall: Vector
    speed: Vector
    voltage: Vector

    @classmethod
    def of(cls, servos: Sequence[Servo]) -> Motors:
        """Prepare those of these servos."""
        return cls(
            vector([servo.model.stall_torque * servo.gear for servo in servos]),
            vector([servo.model.no_load_speed / servo.gear for servo in servos]),
            vector([servo.model.stall_voltage for servo in servos]),
        )

    def duty(self, torque: Vector, velocity: Vector, voltage: Vector) -> Vector:
        """Return the part of the voltage (servos,) that makes a torque; not limited.

        Args:
            torque: (servos,) N·m.
            velocity: (servos,) rad/s.
            voltage: (servos,) V, as measured; NaN where it is not known.
        """
        known = np.where(voltage > 0.0, voltage, self.voltage)
        return (torque / self.stall + MADE_UP * velocity / self.speed) * self.voltage / known
