"""Modes in which the arm gives way to forces: freedrive, teach mode and force mode.

The laws are plain admittances (velocity proportional to force, reached after a short time); the
controller's own are not published.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import exp, inf
from typing import Final

from crtk_sim_backends.ur.motion.arm import Arm
from crtk_sim_backends.ur.motion.kinematics import (
    IDENTITY,
    Floats,
    Kinematics,
    Matrix,
    Transform,
    compose,
    cross,
    invert,
    joint_rates,
    multiply,
    norm,
    rotate,
    rotate_back,
    rotation_vector,
    transpose_multiply,
)

RESPONSE_TIME: Final = 0.02  # s, in which the velocity reaches what the force asks for
JOINT_DAMPING_PER_TORQUE: Final = 0.1  # N.m.s/rad for each N.m of the joint's torque limit
LINEAR_DAMPING: Final = 200.0  # N.s/m: stable on surfaces of up to 30 kN/m, with CB3 10 kN/m
ANGULAR_DAMPING: Final = 5.0  # N.m.s/rad

CORRECTION_RATE: Final = 20.0  # 1/s, with which axes that do not comply come back to the plan

_STILL = 1e-4  # rad/s
_SLOW = 1e-4  # m/s: the direction of a slower motion counts for nothing


class Turning(IntEnum):
    """What turns the task frame of force mode: the argument `type` of `force_mode`."""

    POINT = 1  # its y axis points from the TCP to its origin
    NONE = 2
    MOTION = 3  # its x axis is the direction of the planned motion of the TCP in its x-y plane


@dataclass(frozen=True)
class ForceTask:
    """Arguments of `force_mode`; vectors have three linear and three angular items.

    Attributes:
        frame: task frame in base.
        selection: axes of the task frame that comply.
        wrench: force and torque to press with along those axes, N and N.m.
        limits: largest speed along complying axes, m/s and rad/s.
        turning: what turns the frame while the arm moves.
    """

    frame: Transform
    selection: tuple[bool, ...]
    wrench: tuple[float, ...]
    limits: tuple[float, ...]
    turning: Turning = Turning.NONE


class Compliance:
    """Turns external forces into joint velocities that drift the arm off its plan."""

    def __init__(self, arm: Arm, kinematics: Kinematics) -> None:
        self._arm = arm
        self._kinematics = kinematics
        self._qd = [0.0] * 6
        self._speed = [0.0] * 6
        self._joint_space = True
        self._frame: Transform = IDENTITY  # the last one of a force task
        self._blend = 1.0 - exp(-arm.dt / RESPONSE_TIME)
        self.damping = 0.005  # of force_mode, 0 (coasts) to 1 (stops at once)
        self.gain_scaling = 1.0
        self.force_task: ForceTask | None = None
        self.freedrive_axes: tuple[bool, ...] | None = None
        self.freedrive_frame: Transform = IDENTITY

    @property
    def active(self) -> bool:
        """Whether a compliant mode is on."""
        return self.force_task is not None or self.freedrive_axes is not None

    @property
    def coasts(self) -> bool:
        """Whether the arm still moves from a compliant mode that was left."""
        return any(self._qd) and not self.active

    @property
    def freedrive(self) -> bool:
        """Whether the arm can be pushed about by hand."""
        return self.freedrive_axes is not None

    def end(self) -> None:
        """Leave every compliant mode."""
        self.force_task = None
        self.freedrive_axes = None

    def start_force(self, task: ForceTask) -> None:
        """Begin force mode, or go on with another task."""
        self._begin()
        if self.force_task is None or self.force_task.frame != task.frame:
            self._frame = task.frame
        self.force_task = task

    def start_freedrive(self, frame: Transform, axes: tuple[bool, ...]) -> None:
        """Let the arm be pushed along `axes` of `frame`."""
        self._begin()
        self.freedrive_frame = frame
        self.freedrive_axes = axes

    def _begin(self) -> None:
        """Take the place where the arm rests for the one that axes that do not comply keep."""
        if not self.active and not any(self._arm.plan_qd):
            self._arm.rebase()

    def near_singularity(self) -> bool:
        """Whether freedrive along Cartesian axes is hindered by a singularity."""
        matrix = self._kinematics.jacobian(self._arm.target_q)
        return joint_rates(matrix, (1.0,) * 6, 1e-2) is None

    def step(self, wrench: Floats, tool: Transform) -> None:
        """Set the arm's drift for one period: `wrench` (N, N.m) acts at the tool, base axes."""
        task = self._task()
        if task is None and not self.active:
            self._coast()
            return
        matrix = self._kinematics.jacobian(self._arm.target_q, tool)
        if task is None:
            goal = self._joint_speed(matrix, wrench)
            self._approach(goal, joint_space=True)
            qd = self._speed
        else:
            frame = self._task_frame(task, tool, matrix)
            self._approach(self._tool_speed(task, frame, wrench), joint_space=False)
            qd = self._offset_rates(task, frame, tool, matrix)
        self._qd = qd
        self._arm.drift(qd)

    def _task_frame(self, task: ForceTask, tool: Transform, matrix: Matrix) -> Transform:
        """Frame of the task as it is now."""
        frame = task.frame
        if task.turning is Turning.POINT:
            tcp = compose(self._kinematics.flange(self._arm.target_q), tool)[9:]
            self._frame = _turned(frame, 1, [o - p for o, p in zip(frame[9:], tcp, strict=True)])
        elif task.turning is Turning.MOTION:
            motion = rotate_back(frame, multiply(matrix, self._arm.commanded_qd)[:3])
            if norm(motion[:2]) > _SLOW:
                self._frame = _turned(frame, 0, rotate(frame, (*motion[:2], 0.0)))
        else:
            self._frame = frame
        return self._frame

    def _offset_rates(
        self, task: ForceTask, frame: Transform, tool: Transform, matrix: Matrix
    ) -> list[float]:
        """Joint rates beside the plan's, so that the tool complies along the axes of the task.

        Along the others it moves as the plan does, and comes back to where the plan is.
        """
        arm = self._arm
        flange = self._kinematics.flange
        planned = [v * arm.scale for v in arm.commanded_qd]
        plan_flange = flange(arm.plan_q)
        plan = compose(plan_flange, tool)
        target = compose(flange(arm.target_q), tool)
        away = [p - t for p, t in zip(plan[9:], target[9:], strict=True)]
        turned = rotation_vector(
            compose((*plan[:9], 0.0, 0.0, 0.0), invert((*target[:9], 0.0, 0.0, 0.0)))
        )
        goal = [CORRECTION_RATE * e for e in (*away, *turned)]
        if any(planned):
            plan_matrix = self._kinematics.jacobian(arm.plan_q, tool, plan_flange)
            twist = multiply(plan_matrix, planned)
            goal = [g + v for g, v in zip(goal, twist, strict=True)]
        local = (*rotate_back(frame, goal[:3]), *rotate_back(frame, goal[3:]))
        speed = [
            own if complies else other
            for complies, own, other in zip(task.selection, self._speed, local, strict=True)
        ]
        qd = joint_rates(matrix, (*rotate(frame, speed[:3]), *rotate(frame, speed[3:])))
        return [0.0] * 6 if qd is None else [v - p for v, p in zip(qd, planned, strict=True)]

    def _task(self) -> ForceTask | None:
        """Task in tool space, None when the joints give way freely or not at all."""
        if self.freedrive_axes is None:
            return self.force_task
        if all(self.freedrive_axes):
            return None
        return ForceTask(self.freedrive_frame, self.freedrive_axes, (0.0,) * 6, (inf,) * 6)

    def _coast(self) -> None:
        """Come to rest after a compliant mode."""
        if any(self._qd):
            self._speed = self._qd
            self._approach([0.0] * 6, joint_space=True)
            self._qd = self._speed
            self._arm.drift(self._qd)

    def _approach(self, goal: list[float], joint_space: bool) -> None:
        """Bring the speed (of the joints, or of the tool in the task frame) towards `goal`."""
        if joint_space != self._joint_space:
            self._joint_space = joint_space
            self._speed = self._qd if joint_space else [0.0] * 6
        k = self._blend
        speed = [v + (g - v) * k for v, g in zip(self._speed, goal, strict=True)]
        if not any(goal) and max(map(abs, speed)) < _STILL:
            speed = [0.0] * 6
        self._speed = speed

    def _joint_speed(self, matrix: Matrix, wrench: Floats) -> list[float]:
        torque = transpose_multiply(matrix, wrench)
        limits = self._arm.model.torque
        return [
            t / (JOINT_DAMPING_PER_TORQUE * limit) for t, limit in zip(torque, limits, strict=True)
        ]

    def _tool_speed(self, task: ForceTask, frame: Transform, wrench: Floats) -> list[float]:
        """Speed along the complying axes of the task frame for the net force on them."""
        local = (*rotate_back(frame, wrench[:3]), *rotate_back(frame, wrench[3:]))
        gain = 1.0 if self.freedrive else self.gain_scaling * (1.0 - self.damping)
        speed = [0.0] * 6
        for i in range(6):
            if task.selection[i]:
                damping = LINEAR_DAMPING if i < 3 else ANGULAR_DAMPING
                value = gain * (task.wrench[i] + local[i]) / damping
                speed[i] = max(-task.limits[i], min(task.limits[i], value))
        return speed


def _turned(frame: Transform, axis: int, direction: Floats) -> Transform:
    """`frame` with its x (0) or y (1) axis along `direction`, its z axis as near as possible."""
    size = norm(direction)
    if size < 1e-9:
        return frame
    along = [c / size for c in direction]
    up = (frame[2], frame[5], frame[8])
    if norm(cross(along, up)) < 1e-6:  # the z axis cannot stay: the other one does
        up = (frame[1 - axis], frame[4 - axis], frame[7 - axis])
    across = cross(up, along) if axis == 0 else cross(along, up)
    size = norm(across)
    across = (across[0] / size, across[1] / size, across[2] / size)
    x, y = (along, across) if axis == 0 else (across, along)
    z = cross(x, y)
    return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2], *frame[9:])
