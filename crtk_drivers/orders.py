"""From a checked CRTK command to what the I/O thread executes.

Runs in the client's thread and touches no bus: what can be refused is refused before it is queued, also
what only inverse kinematics or the distance from the present setpoint can tell.
"""

from __future__ import annotations

import numpy as np

from crtk_drivers.arbiter import Order
from crtk_drivers.commands import COMMANDS, Command, Level
from crtk_drivers.device import Device, Goal, Mode, Setpoint
from crtk_drivers.errors import CommandRefused, KinematicsError, Reason
from crtk_drivers.feedback import Feedback
from crtk_drivers.limits import CommandCheck, SetpointLimiter
from crtk_drivers.moves import Move
from crtk_drivers.samples import (
    EMPTY,
    JointState,
    Pose,
    Twist,
    Value,
    Vector,
    Wrench,
    joint_values,
    vector,
)

_JOINT_MODES = {
    "servo_jp": Mode.JOINT_POSITION,
    "servo_jv": Mode.JOINT_VELOCITY,
    "servo_jf": Mode.JOINT_EFFORT,
}


class OrderMaker:
    """Makes orders for one device."""

    def __init__(
        self,
        device: Device,
        where: str,
        check: CommandCheck,
        limiter: SetpointLimiter,
        feedback: Feedback,
    ) -> None:
        self._device = device
        self._modes = device.capabilities.modes
        self._has_kinematics = device.capabilities.has_kinematics
        self._where = where
        self._check = check
        self._limiter = limiter
        self._feedback = feedback

    def make(self, command: Command, value: Value) -> Order:
        """Return the order of a servo or move command whose value passed its check.

        Raises:
            CommandRefused: too far from the present setpoint, or out of reach.
        """
        if command.level is Level.MOVE:
            return self._move(command, value)
        return self._servo(command, value)

    def _servo(self, command: Command, value: Value) -> Order:
        if command.is_relative:
            assert isinstance(value, JointState)
            return Order(command.name, increment=value.position)
        setpoint = self._setpoint(command, value)
        before = self._feedback.before(setpoint.mode)
        return Order(command.name, self._limiter.limit(command.name, setpoint, before))

    def _setpoint(self, command: Command, value: Value) -> Setpoint:
        if isinstance(value, JointState):
            return Setpoint(_JOINT_MODES[command.name], joint_values(command.kind, value))
        if isinstance(value, Twist):
            return Setpoint(Mode.CARTESIAN_VELOCITY, vector(value.vector))
        if isinstance(value, Wrench):
            return Setpoint(Mode.CARTESIAN_EFFORT, vector(value.vector))
        assert isinstance(value, Pose)
        if Mode.CARTESIAN_POSITION in self._modes:
            numbers = np.concatenate((value.position, value.orientation))
            return Setpoint(Mode.CARTESIAN_POSITION, vector(numbers))
        return Setpoint(Mode.JOINT_POSITION, self._reach(command.name, value))

    def _move(self, command: Command, value: Value) -> Order:
        name = command.name
        if isinstance(value, Pose):
            joints = self._reach(name, value) if self._has_kinematics else EMPTY
            return Order(name, goal=Goal(pose=value), joints=joints, move=Move(name))
        assert isinstance(value, JointState)
        target = value.position
        if command.is_relative:
            target = vector(self._feedback.reference_joints() + target)
            self._check.check(COMMANDS["move_jp"], JointState(position=target))
        return Order(name, goal=Goal(joints=target), joints=target, move=Move(name))

    def _reach(self, name: str, pose: Pose) -> Vector:
        try:
            return self._device.inverse_kinematics(pose, self._feedback.reference_joints())
        except KinematicsError as error:
            raise CommandRefused(
                name,
                Reason.UNREACHABLE,
                error.message,
                where=self._where,
                remedy=error.remedy or "Choose a pose within reach, away from singularities.",
            ) from error
