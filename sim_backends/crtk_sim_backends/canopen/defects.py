"""Defects of simulated drives, for a bench that must find them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from crtk_sim_backends.canopen.plant import Motor
from crtk_sim_backends.defects import JointDefects, Sense


@dataclass(frozen=True, kw_only=True)
class AxisDefects(JointDefects):
    """What is wrong with the axes of a drive; angles in rad of the motor, joints by node-IDs.

    Attributes:
        following_offset: by which it rests beside its target.
        sag_on_disable: by which it falls, the negative way, before its brake holds.
        slow_stop: times as long as configured that quick stop, halt and the other ramps take.
        ignores_watchdog: 1: it goes on when heartbeats or SYNC stay away.
    """

    following_offset: float = 0.0
    sag_on_disable: float = 0.0
    slow_stop: float = 1.0
    ignores_watchdog: int = 0


NONE = AxisDefects()


class Measuring:
    """What a drive measures of its motor, and that it falls when power goes.

    Args:
        motor: that is measured.
        number: of the axis.
        defects: of the axis; None: it has none.
    """

    def __init__(self, motor: Motor, number: int, defects: AxisDefects | None) -> None:
        self.defects = defects or NONE
        self._motor = motor
        self._sense = None if defects is None else Sense(defects, number)
        self._time = 0.0  # s that the axis has lived
        self._was_powered = False
        self._told_at = -1.0
        self._told = 0.0, 0.0, 0.0

    @property
    def changes(self) -> bool:
        """Whether what it measures changes while the motor stands."""
        return self._sense is not None

    def live(self, dt: float, *, powered: bool) -> None:
        """Go on by `dt` seconds."""
        self._time += dt
        if self._was_powered and not powered:
            self._motor.position -= self.defects.sag_on_disable
        self._was_powered = powered

    def tell(self, torque: float) -> tuple[float, float, float]:
        """Return position (revolutions), velocity (rad/s) and torque (N·m) of the motor as measured."""
        motor = self._motor
        if self._sense is None:
            return motor.revolutions, motor.velocity, torque
        if self._told_at != self._time:
            self._told_at = self._time
            q, v, torque = self._sense.tell(motor.position, motor.velocity, torque, self._time)
            self._told = q / math.tau, v, torque
        return self._told
