"""From the states of boards to joints: conversions, the coupling, and whether a state can be believed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

import numpy as np

from crtk_driver_dvrk.arm_file import Actuator, Arm, Linear
from crtk_driver_dvrk.registers import AXES, AxisState, BoardState
from crtk_drivers.samples import EMPTY, Array, JointState, frozen

States = Mapping[int, BoardState]
"""By the number of the board."""

FASTEST: Final = 2e6
"""Counts/s: faster than that no motor of a da Vinci turns its encoder."""

_SLACK: Final = 0.02
"""Seconds of that which are always allowed."""


class Joints:
    """Makes joint states of the states of boards.

    Args:
        arm: what dVRK's files say.
        names: of the joints.
    """

    def __init__(self, arm: Arm, names: tuple[str, ...]) -> None:
        self._arm = arm
        self._names = names
        self._coupling = arm.coupling
        self._efforts = np.linalg.inv(arm.coupling).T  # virtual work: what coupling does to efforts
        self._sensed = arm.coupling @ arm.sensed
        lines = np.array([_lines(actuator) for actuator in arm.actuators])
        self._scale, self._offset = lines[:, :, 0], lines[:, :, 1]
        self._has_efforts, self._has_potentiometers = arm.has_efforts, arm.has_potentiometers

    def axis(self, states: States, actuator: Actuator) -> AxisState:
        """Return the axis of an actuator."""
        return states[actuator.board_id].axes[actuator.axis_id]

    def values(self, states: States) -> dict[str, JointState]:
        """Return what a sample holds.

        ``measured_js`` has positions and velocities by encoders, and efforts by currents, where these are
        known; ``measured2_js``, where there are potentiometers, positions by these, which know where they are
        without having been homed.
        """
        axes = [self.axis(states, actuator) for actuator in self._arm.actuators]
        bits = [(a.counts, a.velocity, a.current, a.potentiometer) for a in axes]
        told = np.array(bits) * self._scale + self._offset
        joints = self._coupling @ told[:, :2]
        effort = frozen(self._efforts @ told[:, 2]) if self._has_efforts else EMPTY
        position, velocity = frozen(joints[:, 0]), frozen(joints[:, 1])
        values = {"measured_js": JointState(position, velocity, effort, name=self._names)}
        if self._has_potentiometers:
            sensed = frozen(self._sensed @ told[:, 3])
            values["measured2_js"] = JointState(sensed, name=self._names)
        return values

    def of_actuators(self, states: States) -> tuple[Array, Array]:
        """Return where encoders, and where potentiometers say that actuators are: (n,) each, in rad (m)."""
        axes = [self.axis(states, actuator) for actuator in self._arm.actuators]
        bits = np.array([(axis.counts, axis.potentiometer) for axis in axes])
        told = bits * self._scale[:, (0, 3)] + self._offset[:, (0, 3)]
        return told[:, 0], self._arm.sensed @ told[:, 1]

    def counts(self, positions: Array) -> list[int]:
        """Return what encoders must count, from the middle, for positions of actuators (n,), in rad (m)."""
        counts = (positions - self._offset[:, 0]) / self._scale[:, 0]
        return [round(count) for count in counts.tolist()]

    def potentiometers(self, states: States) -> tuple[float, ...]:
        """Return what each potentiometer measures, in rad (m); there is one for each actuator."""
        bits = [self.axis(states, actuator).potentiometer for actuator in self._arm.actuators]
        return tuple((np.array(bits) * self._scale[:, 3] + self._offset[:, 3]).tolist())

    def currents(self, states: States) -> tuple[float, ...]:
        """Return the current of each actuator, in A; 0 where the file does not say how bits become A."""
        return tuple(
            actuator.drive.bits_to_current.of(self.axis(states, actuator).current)
            if actuator.drive is not None
            else 0.0
            for actuator in self._arm.actuators
        )


_Line = tuple[float, float]
"""Scale and offset."""

_UNKNOWN: Final[_Line] = (0.0, 0.0)


def _lines(actuator: Actuator) -> tuple[_Line, _Line, _Line, _Line]:
    """Return how counts, counts/s, and bits of current and potentiometer, become SI units of an actuator."""
    encoder, drive, sensor = (
        actuator.encoder.bits_to_position,
        actuator.drive,
        actuator.potentiometer,
    )
    effort = drive.effort_to_current if drive is not None else None
    return (
        (encoder.scale, encoder.offset),
        (encoder.scale, 0.0),
        _after(drive.bits_to_current, (1.0 / effort.scale, -effort.offset / effort.scale))
        if drive is not None and effort is not None
        else _UNKNOWN,
        _after(sensor.bits_to_voltage, sensor.voltage_to_position.line)
        if sensor is not None
        else _UNKNOWN,
    )


def _after(first: Linear, then: _Line) -> _Line:
    """Return the line of one after another."""
    return then[0] * first.scale, then[0] * first.offset + then[1]


def wrong(state: BoardState, board: int, axes: Collection[int]) -> str:
    """Return why positions of a board cannot be relied on, in words; empty if they can.

    Args:
        state: of the board.
        board: number of the board that was asked.
        axes: those that the arm has there.
    """
    if state.board != board or state.channels != AXES:
        return f"it answers as board {state.board} with {state.channels} axes"
    if state.encoder_supply_fault:
        return "the supply of its encoders has a fault"
    for at in axes:
        if state.axes[at].overflow:
            return f"the encoder of axis {at} has counted beyond its range"
    return ""


def can_follow(
    state: BoardState, before: BoardState, axes: Collection[int], seconds: float
) -> bool:
    """Whether encoders can have come from one state to another in some seconds."""
    most = FASTEST * (seconds + _SLACK)
    return all(abs(state.axes[at].counts - before.axes[at].counts) <= most for at in axes)
