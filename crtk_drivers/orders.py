"""From a checked CRTK command to what the I/O thread executes.

Runs in the client's thread and touches no bus: what can be refused is refused before it is queued, also
what only inverse kinematics or the distance from the present setpoint can tell.
"""

from __future__ import annotations

from crtk_drivers.arbiter import Order
from crtk_drivers.commands import Command, Kind, Level
from crtk_drivers.device import Device, Goal, Mode, Setpoint
from crtk_drivers.feedback import Feedback
from crtk_drivers.limits import CommandCheck, SetpointLimiter
from crtk_drivers.moves import Move
from crtk_drivers.reach import Reach
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
        reach: Reach,
        check: CommandCheck,
        limiter: SetpointLimiter,
        feedback: Feedback,
    ) -> None:
        self._device = device
        self._joints = device.capabilities.joints
        self._takes_twists = Mode.CARTESIAN_VELOCITY in device.capabilities.modes
        self._takes_poses = Mode.CARTESIAN_POSITION in device.capabilities.modes
        self._moves_poses = "move_cp" in device.capabilities.native_moves
        self._has_kinematics = device.capabilities.has_kinematics
        self._reach = reach
        self._check = check
        self._limiter = limiter
        self._feedback = feedback

    def make(self, command: Command, value: Value) -> Order:
        """Return the order of a motion command whose value passed its check.

        Raises:
            CommandRefused: too far from the present setpoint, or out of reach.
        """
        if command.level is Level.MOVE:
            return self._move(command, value)
        if command.level is Level.INTERPOLATE:
            return self._interpolate(command, value)
        return self._servo(command, value)

    def _servo(self, command: Command, value: Value) -> Order:
        if command.is_relative:
            if isinstance(value, Pose):
                return self._displace(command, value)
            assert isinstance(value, JointState)
            before = self._reach.reference(command)
            target = Setpoint(Mode.JOINT_POSITION, vector(before + value.position))
            self._limiter.judge(command.name, target, before)
            return Order(command.name, increment=value.position)
        if isinstance(value, Twist) and not self._takes_twists:
            self._reach.reference(command)
            return Order(command.name, target=value)
        setpoint = self._setpoint(command, value)
        self._limiter.judge(command.name, setpoint, self._feedback.before(setpoint.mode))
        return Order(command.name, setpoint)

    def _displace(self, command: Command, value: Pose) -> Order:
        target = self._reach.setpoint(command, self._reach.moved(command, value))
        self._limiter.judge(command.name, target, self._feedback.before(target.mode))
        return Order(command.name, displacement=value)

    def _setpoint(self, command: Command, value: Value) -> Setpoint:
        if isinstance(value, JointState):
            return Setpoint(_JOINT_MODES[command.name], joint_values(command.kind, value))
        if isinstance(value, Twist):
            return Setpoint(Mode.CARTESIAN_VELOCITY, vector(value.vector))
        if isinstance(value, Wrench):
            return Setpoint(Mode.CARTESIAN_EFFORT, vector(value.vector))
        assert isinstance(value, Pose)
        return self._reach.setpoint(command, value)

    def _interpolate(self, command: Command, value: Value) -> Order:
        if isinstance(value, Pose):
            return self._interpolate_pose(command, value)
        if isinstance(value, Twist):
            return Order(command.name, target=value)
        assert isinstance(value, JointState)
        before = self._reach.reference(command)
        if command.is_relative:
            return Order(command.name, increment=value.position)
        if command.kind is Kind.POSITION:
            self._limiter.into_range(command.name, value.position, before)
        return Order(command.name, target=value)

    def _interpolate_pose(self, command: Command, value: Pose) -> Order:
        if command.is_relative:
            self._reach.pose(command)
            return Order(command.name, displacement=value)
        if not self._takes_poses:
            self._reach.joints(command, value)
        return Order(command.name, target=value)

    def _move(self, command: Command, value: Value) -> Order:
        name = command.name
        if isinstance(value, Pose):
            if command.is_relative:
                value = self._reach.moved(command, value, native=self._moves_poses)
            joints = self._reach.joints(command, value) if self._has_kinematics else EMPTY
            return self._order_to(name, Goal(pose=value), joints)
        assert isinstance(value, JointState)
        target = value.position
        if command.is_relative:
            target = vector(self._reach.reference(command) + target)
            self._check.check_target(command, target)
        return self._order_to(name, Goal(joints=target), target)

    def _order_to(self, name: str, goal: Goal, joints: Vector) -> Order:
        goals: dict[str, Value] = {}
        if joints.size:
            goals["goal_js"] = JointState(position=joints, name=self._joints)
        if goal.pose is not None:
            goals["goal_cp"] = goal.pose
        elif self._has_kinematics:
            goals["goal_cp"] = self._device.forward_kinematics(joints)
        return Order(name, goal=goal, joints=joints, goals=goals, move=Move(name))
