"""From a checked CRTK command to what the I/O thread executes.

Runs in the client's thread and touches no bus: what can be refused is refused before it is queued, also
what only inverse kinematics or the distance from the present setpoint can tell.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from crtk_drivers.commands import Command, Kind, Level, Space
from crtk_drivers.device import FULL, Goal, Mode, Ratios, Setpoint, mode_of
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.frames import pose_in_base, product, wrench_in_base
from crtk_drivers.motion.arbiter import Order, Path
from crtk_drivers.motion.context import MotionContext
from crtk_drivers.motion.mixed import aimed
from crtk_drivers.motion.move import Move
from crtk_drivers.motion.stopping import still_speeds
from crtk_drivers.samples import (
    EMPTY,
    AxisMode,
    CartesianServo,
    JointServo,
    JointState,
    JointTrajectory,
    Pose,
    Twist,
    Value,
    Vector,
    Wrench,
    joint_values,
    vector,
)
from crtk_drivers.trajectory.checks import TrajectoryCheck
from crtk_drivers.trajectory.tolerances import UNLIMITED, Tolerances, limits_of
from crtk_drivers.trajectory.waypoints import JoinedPath, Spline


class OrderMaker:
    """Makes orders for one device.

    Args:
        context: of the device.

    Attributes:
        ratios: of the moves that are made from now on.
    """

    def __init__(self, context: MotionContext) -> None:
        capabilities = context.capabilities
        self._device = context.device
        self._capabilities = capabilities
        self._modes = capabilities.modes
        self._takes_poses = Mode.CARTESIAN_POSITION in capabilities.modes
        self._moves_poses = "move_cp" in capabilities.native_moves
        self._inverse = context.inverse
        self._check = context.check
        self._limiter = context.limiter
        self._feedback = context.feedback
        self._max_step = context.options.limits.max_step
        self._ways = TrajectoryCheck(capabilities, context.where)
        self._where = context.where
        moves_joints = (
            Mode.JOINT_POSITION in capabilities.modes or "move_jp" in capabilities.native_moves
        )
        self._by_joints = moves_joints and context.options.move_cp == "joints"
        self.ratios: Ratios = FULL

    def make(self, command: Command, value: Value, now: float) -> Order:
        """Return the order of a motion command whose value passed its check, at monotonic seconds.

        Raises:
            CommandRefused: too far from the present setpoint, or out of reach.
        """
        if isinstance(value, Pose) and not command.is_relative:
            value = self._in_base(command, value)
        elif isinstance(value, CartesianServo):
            value = replace(value, task=self._in_base(command, value.task))
        if isinstance(value, JointTrajectory):
            return self._follow(command, value, now)
        if command.level is Level.MOVE:
            return self._move(command, value, now)
        if command.level is Level.INTERPOLATE:
            return self._interpolate(command, value)
        return self._servo(command, value)

    def _in_base(self, command: Command, pose: Pose) -> Pose:
        pose = pose_in_base(pose, command.frame, self._capabilities.base_pose)
        return replace(pose, frame_id=self._capabilities.base_frame)

    # ---------------------------------------------------------------------------------------- servo

    def _servo(self, command: Command, value: Value) -> Order:
        if isinstance(value, JointState):
            return self._servo_joints(command, value)
        if isinstance(value, Pose):
            return self._servo_pose(command, value)
        if isinstance(value, JointServo):
            return self._servo_mixed_joints(command, value)
        if isinstance(value, CartesianServo):
            return self._servo_mixed_axes(command, value)
        assert isinstance(value, Twist | Wrench)
        mode = mode_of(Space.CARTESIAN, command.kind)
        if command.frame or mode not in self._modes:
            self._inverse.pose(command)
            return Order(command.name, target=value)
        return self._direct(command, Setpoint(mode, vector(value.vector)))

    def _direct(self, command: Command, setpoint: Setpoint) -> Order:
        self._limiter.judge(command.name, setpoint, self._feedback.before(setpoint.mode))
        return Order(command.name, setpoint)

    def _servo_joints(self, command: Command, value: JointState) -> Order:
        if not command.is_relative:
            mode = mode_of(Space.JOINT, command.kind)
            return self._direct(command, Setpoint(mode, joint_values(command.kind, value)))
        before = self._inverse.reference(command)
        target = Setpoint(Mode.JOINT_POSITION, vector(before + value.position))
        self._limiter.judge(command.name, target, before)
        return Order(command.name, increment=value.position)

    def _servo_pose(self, command: Command, value: Pose) -> Order:
        goal = self._inverse.moved(command, value) if command.is_relative else value
        setpoint = self._inverse.setpoint(command, goal)
        if setpoint.mode is Mode.CARTESIAN_POSITION or self._capabilities.cartesian_limits is None:
            order = self._direct(command, setpoint)
        else:
            before = self._feedback.reference_joints()
            self._limiter.into_range(command.name, setpoint.values, before)
            self._limiter.judge_tool(command.name, goal, self._inverse.pose(command))
            order = Order(command.name, setpoint, target=goal)
        return Order(command.name, displacement=value) if command.is_relative else order

    def _servo_mixed_joints(self, command: Command, value: JointServo) -> Order:
        modes = np.array(value.modes)
        used = {AxisMode(mode) for mode in value.modes} - {AxisMode.NONE}
        self._require_some(command, used)
        if used == {AxisMode.POSITION} and Mode.JOINT_POSITION in self._modes:
            before = self._inverse.reference(command)
            position = np.where(modes == AxisMode.POSITION, value.position, before)
            return self._direct(command, Setpoint(Mode.JOINT_POSITION, vector(position)))
        if len(used) == 1:
            (only,) = used
            values = value.velocity if only is AxisMode.VELOCITY else value.effort
            mode = mode_of(Space.JOINT, Kind[only.name])
            if mode in self._modes:
                return self._direct(command, Setpoint(mode, values))
        if AxisMode.EFFORT in used or Mode.JOINT_POSITION not in self._modes:
            raise self._unsupported(command, used)
        if AxisMode.POSITION in used:
            before = self._inverse.reference(command)
            position = np.where(modes == AxisMode.POSITION, value.position, before)
            self._limiter.judge(
                command.name, Setpoint(Mode.JOINT_POSITION, vector(position)), before
            )
        return Order(command.name, target=value)

    def _servo_mixed_axes(self, command: Command, value: CartesianServo) -> Order:
        used = {AxisMode(mode) for mode in value.modes} - {AxisMode.NONE}
        self._require_some(command, used)
        if AxisMode.EFFORT not in used:
            here = self._inverse.pose(command)
            if AxisMode.POSITION in used:
                self._servo_pose(command, product(value.task, aimed(value, here)))  # or refused
            return Order(command.name, target=value)
        if used != {AxisMode.EFFORT}:
            raise self._unsupported(command, used)
        # The task frame's axes, at the tool point.
        wrench = wrench_in_base(vector(value.wrench.vector), "body", value.task)
        if Mode.CARTESIAN_EFFORT in self._modes:
            return self._direct(command, Setpoint(Mode.CARTESIAN_EFFORT, wrench))
        kinematics = self._device.kinematics
        if Mode.JOINT_EFFORT not in self._modes or kinematics is None:
            raise self._unsupported(command, used)
        joints, _ = self._feedback.measured_state()
        jacobian = kinematics.jacobian(joints.position)
        return self._direct(command, Setpoint(Mode.JOINT_EFFORT, vector(jacobian.T @ wrench)))

    def _require_some(self, command: Command, used: set[AxisMode]) -> None:
        if not used:
            raise CommandRefused(
                command.name,
                Reason.EMPTY,
                "no axis has a mode",
                where=self._where,
                remedy="Set POSITION (1), VELOCITY (2) or EFFORT (4) for an axis, or send hold.",
            )

    def _unsupported(self, command: Command, used: set[AxisMode]) -> CommandRefused:
        names = " and ".join(sorted(mode.name.lower() for mode in used))
        return CommandRefused(
            command.name,
            Reason.UNSUPPORTED,
            f"{names}, on hardware that takes {', '.join(sorted(self._modes))}",
            where=self._where,
            remedy="Position and velocity can be mixed where joints take positions; efforts stand alone.",
        )

    # ---------------------------------------------------------------------------------- interpolate

    def _interpolate(self, command: Command, value: Value) -> Order:
        if isinstance(value, Pose):
            return self._interpolate_pose(command, value)
        if isinstance(value, Twist | Wrench):
            if command.frame:
                self._inverse.pose(command)
            return Order(command.name, target=value)
        assert isinstance(value, JointState)
        before = self._inverse.reference(command)
        if command.is_relative:
            return Order(command.name, increment=value.position)
        if command.kind is Kind.POSITION:
            self._limiter.into_range(command.name, value.position, before)
        return Order(command.name, target=value)

    def _interpolate_pose(self, command: Command, value: Pose) -> Order:
        if command.is_relative:
            self._inverse.pose(command)
            return Order(command.name, displacement=value)
        if not self._takes_poses:
            self._inverse.joints(command, value)
        return Order(command.name, target=value)

    # ----------------------------------------------------------------------------------------- move

    def _move(self, command: Command, value: Value, now: float) -> Order:
        if isinstance(value, Pose):
            return self._move_pose(command, value, now)
        assert isinstance(value, JointState)
        target = value.position
        if command.is_relative:
            target = vector(self._inverse.reference(command) + target)
            self._check.check_target(command, target)
        return self._order_to(command, Goal(joints=target, ratios=self.ratios), target)

    def _follow(self, command: Command, value: JointTrajectory, now: float) -> Order:
        trajectory = self._ways.checked(value, now_ns := time.time_ns())
        spline = Spline(
            trajectory.times,
            trajectory.positions,
            trajectory.velocities,
            trajectory.accelerations,
        )
        self._ways.check_way(spline)
        ahead = 1e-9 * (trajectory.start_ns - now_ns) if trajectory.start_ns else 0.0
        self._inverse.reference(command)
        limits = self._capabilities.limits
        joined = JoinedPath(spline, -ahead, self._feedback.motion(now), limits)
        self._ways.check_pull(joined.pull)
        self._ways.check_start(joined.off, self._max_step)
        if joined.lead is not None:
            self._ways.check_way(joined.lead)
        tolerances = self._tolerances_of(trajectory)
        path = Path(spline, now + ahead if trajectory.start_ns else None, tolerances)
        goal = vector(trajectory.positions[-1])
        return replace(self._order_to(command, Goal(joints=goal), goal), path=path)

    def _tolerances_of(self, trajectory: JointTrajectory) -> Tolerances:
        capabilities = self._capabilities
        count, following = len(capabilities.joints), capabilities.following
        free = (UNLIMITED,) * count
        arrival = free if following is None else following.arrival
        still = still_speeds(capabilities)
        return Tolerances(
            limits_of(capabilities.joints, trajectory.path, free, free),
            limits_of(capabilities.joints, trajectory.goal, arrival, still),
            trajectory.goal_time,
        )

    def _move_pose(self, command: Command, value: Pose, now: float) -> Order:
        if command.is_relative:
            value = self._inverse.moved(command, value, native=self._moves_poses)
        limits = self._capabilities.line_limits or self._capabilities.cartesian_limits
        if self._device.kinematics is None:
            return self._order_to(command, Goal(pose=value, ratios=self.ratios), EMPTY, value)
        joints = self._inverse.joints(command, value)
        if self._by_joints or (limits is None and not self._moves_poses):
            goal = Goal(joints=joints, ratios=self.ratios)
            return self._order_to(command, goal, joints, value)
        if limits is not None:
            begins = None if self._moves_poses else now
            joints = self._inverse.line(command, value, limits, self.ratios, begins)
        return self._order_to(command, Goal(pose=value, ratios=self.ratios), joints, value)

    def _order_to(
        self, command: Command, goal: Goal, joints: Vector, pose: Pose | None = None
    ) -> Order:
        goals: dict[str, Value] = {}
        kinematics = self._device.kinematics
        if joints.size:
            goals["goal_js"] = JointState(position=joints)
        if pose is not None:
            goals["goal_cp"] = pose
        elif kinematics is not None:
            goals["goal_cp"] = kinematics.forward(joints)
        return Order(command.name, goal=goal, joints=joints, goals=goals, move=Move(command.name))
