"""Modes in which the arm gives way to forces: freedrive, teach mode and force mode.

The laws are plain admittances (velocity proportional to force, reached after a short time); the
controller's own are not published.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf
from typing import Final

from crtk_sim_backends.ur.arm import Arm
from crtk_sim_backends.ur.kinematics import (
    IDENTITY,
    Floats,
    Kinematics,
    Matrix,
    Transform,
    joint_rates,
    rotate,
    rotate_back,
    transpose_multiply,
)

RESPONSE_TIME: Final = 0.05  # s, in which the velocity reaches what the force asks for
JOINT_DAMPING_PER_TORQUE: Final = 0.1  # N.m.s/rad for each N.m of the joint's torque limit
LINEAR_DAMPING: Final = 100.0  # N.s/m
ANGULAR_DAMPING: Final = 5.0  # N.m.s/rad

_STILL = 1e-4  # rad/s


@dataclass(frozen=True)
class ForceTask:
    """Arguments of `force_mode`; vectors have three linear and three angular items.

    Attributes:
        frame: task frame in base.
        selection: axes of the task frame that comply.
        wrench: force and torque to press with along those axes, N and N.m.
        limits: largest speed along complying axes, m/s and rad/s.
    """

    frame: Transform
    selection: tuple[bool, ...]
    wrench: tuple[float, ...]
    limits: tuple[float, ...]


class Compliance:
    """Turns external forces into joint velocities that drift the arm off its plan."""

    def __init__(self, arm: Arm, kinematics: Kinematics) -> None:
        self._arm = arm
        self._kinematics = kinematics
        self._qd = [0.0] * 6
        self._speed = [0.0] * 6
        self._joint_space = True
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
    def freedrive(self) -> bool:
        """Whether the arm can be pushed about by hand."""
        return self.freedrive_axes is not None

    def end(self) -> None:
        """Leave every compliant mode."""
        self.force_task = None
        self.freedrive_axes = None

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
            self._approach(self._tool_speed(task, wrench), joint_space=False)
            linear = rotate(task.frame, self._speed[:3])
            angular = rotate(task.frame, self._speed[3:])
            qd = joint_rates(matrix, (*linear, *angular)) or [0.0] * 6
        self._qd = qd
        self._arm.drift(qd)

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

    def _tool_speed(self, task: ForceTask, wrench: Floats) -> list[float]:
        """Speed along the complying axes of the task frame for the net force on them."""
        local = (*rotate_back(task.frame, wrench[:3]), *rotate_back(task.frame, wrench[3:]))
        gain = 1.0 if self.freedrive else self.gain_scaling * (1.0 - self.damping)
        speed = [0.0] * 6
        for i in range(6):
            if task.selection[i]:
                damping = LINEAR_DAMPING if i < 3 else ANGULAR_DAMPING
                value = gain * (task.wrench[i] + local[i]) / damping
                speed[i] = max(-task.limits[i], min(task.limits[i], value))
        return speed
