"""The controller of an axis: position, velocity and torque loop with their limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from crtk_sim_backends.canopen.dictionary import DataType
from crtk_sim_backends.canopen.homing import Switch
from crtk_sim_backends.canopen.modes import Control, Setpoint
from crtk_sim_backends.canopen.plant import Motor
from crtk_sim_backends.canopen.units import Units

PARAMETERS: Final = (0x6065, 0x6072, 0x6073, 0x6076, 0x607D, 0x6080, 0x6085, 0x60E0, 0x60E1)

_POSITION_GAIN: Final = 60.0  # 1/s
_VELOCITY_GAIN: Final = 500.0  # 1/s, of the inertia
_INTEGRAL_GAIN: Final = 20_000.0  # 1/s², of the inertia
_NO_WINDOW: Final = 0xFFFF_FFFF


def position_range(value: Callable[[int, int], int]) -> tuple[int, int]:
    """Software position limits (607D); equal ones are none."""
    low, high = value(0x607D, 1), value(0x607D, 2)
    return DataType.I32.limits if low == high else (low, high)


class Controller:
    """Cascade of three loops; the torque loop is as fast as it needs to be.

    `update` reads the objects in :data:`PARAMETERS` and the units, which is too slow for every
    control period.

    Args:
        value: reads an object of the axis.
        units: of the axis.
        motor: what is controlled.
        switch: whether a limit switch is active.
        torque_unit: N·m for one unit of the rated torque.

    Attributes:
        saturated: the torque is at its limit.
        held: a limit switch, a software limit or the greatest speed holds the motor back.
        fastest: greatest speed of the motor, rad/s.
        window: following error window, position units; infinite when there is none.
    """

    def __init__(
        self,
        value: Callable[[int, int], int],
        units: Units,
        motor: Motor,
        switch: Callable[[Switch], bool],
        torque_unit: float,
    ) -> None:
        self._torque_unit = torque_unit
        self._value = value
        self._units = units
        self._motor = motor
        self._switch = switch
        self.saturated = False
        self.held = False
        self._integral = 0.0  # N·m
        self._last_velocity = 0.0  # of the setpoint, for the feed-forward
        self.update()

    def update(self) -> None:
        """Read the parameters."""
        value = self._value
        self.scale = self._units.per_radian
        self._sign = 1 if self.scale > 0 else -1
        self._permille = value(0x6076, 0) * self._torque_unit / 1000  # N·m
        most = min(value(0x6072, 0), value(0x6073, 0))
        up, down = min(most, value(0x60E0, 0)), min(most, value(0x60E1, 0))
        if self._sign < 0:
            up, down = down, up
        self._up, self._down = up * self._permille, -down * self._permille
        self.fastest = value(0x6080, 0) * 2 * math.pi / 60
        self._deceleration = value(0x6085, 0) / self._units.acceleration
        self._low, self._high = position_range(value)
        window = value(0x6065, 0)
        self.window = math.inf if window == _NO_WINDOW else window

    def reset(self, velocity: float) -> None:
        """Begin anew with a setpoint that has this velocity."""
        self._integral = 0.0
        self._last_velocity = velocity

    def reference_velocity(self, setpoint: Setpoint, position: float) -> float:
        """What the velocity loop follows, position units a second."""
        if setpoint.control is Control.POSITION:
            return setpoint.velocity + _POSITION_GAIN * (setpoint.position - position)
        return setpoint.velocity

    def torque(self, setpoint: Setpoint, position: float, dt: float) -> float:
        """Torque of the motor in this control period, N·m."""
        motor = self._motor
        inertia = motor.config.inertia
        slowest, fastest = -self.fastest, self.fastest
        self.held = False
        if setpoint.control is not Control.POSITION:
            slowest, fastest = self._velocity_range(position)
        feed_forward = setpoint.torque * self._permille * self._sign
        if setpoint.control is Control.TORQUE:
            gain = inertia * _VELOCITY_GAIN
            load = motor.load()
            high = gain * (fastest - motor.velocity) + load
            low = gain * (slowest - motor.velocity) + load
            self._integral = self._last_velocity = 0.0
            wanted = min(max(feed_forward, low), high)
            self.held = wanted != feed_forward
        else:
            reference = self.reference_velocity(setpoint, position) / self.scale
            permitted = min(max(reference, slowest), fastest)
            self.held = permitted != reference and setpoint.control is Control.VELOCITY
            error = permitted - motor.velocity
            change = (setpoint.velocity - self._last_velocity) / self.scale / dt
            self._last_velocity = setpoint.velocity
            wanted = inertia * (_VELOCITY_GAIN * error + change) + self._integral + feed_forward
            if self._down < wanted < self._up:
                self._integral += inertia * _INTEGRAL_GAIN * error * dt
        result = min(max(wanted, self._down), self._up)
        self.saturated = result != wanted
        return result

    def _velocity_range(self, position: float) -> tuple[float, float]:
        """Velocities of the motor with which it can stop before its limits, rad/s."""
        scale = abs(self.scale)
        twice = 2 * self._deceleration
        up = math.sqrt(twice * max(0.0, self._high - position)) / scale
        down = math.sqrt(twice * max(0.0, position - self._low)) / scale
        up = 0.0 if self._switch(Switch.POSITIVE) else min(up, self.fastest)
        down = 0.0 if self._switch(Switch.NEGATIVE) else min(down, self.fastest)
        return (-down, up) if self._sign > 0 else (-up, down)
