"""Modes in which the arm gives way to forces: freedrive, teach mode and force mode.

The laws are plain admittances (velocity proportional to force, reached after a short time); the
controller's own are not published.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp
from typing import Final

from crtk_sim_backends.ur.arm import Arm
from crtk_sim_backends.ur.kinematics import (
    IDENTITY,
    Floats,
    Kinematics,
    Transform,
    rotate,
    rotate_back,
    solve,
    transpose_multiply,
)

RESPONSE_TIME: Final = 0.05  # s, in which the velocity reaches what the force asks for
JOINT_DAMPING_PER_TORQUE: Final = 0.1  # N.m.s/rad for each N.m of the joint's torque limit
LINEAR_DAMPING: Final = 100.0  # N.s/m
ANGULAR_DAMPING: Final = 5.0  # N.m.s/rad

_STILL = 1e-6  # rad/s


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
        return solve(matrix, (1.0,) * 6, 1e-2) is None

    def step(self, wrench: Floats, tool: Transform) -> None:
        """Set the arm's drift for one period: `wrench` (N, N.m) acts at the tool, base axes."""
        if self.freedrive_axes is not None:
            goal = self._freedrive_velocity(self.freedrive_axes, wrench, tool)
        elif self.force_task is not None:
            goal = self._force_velocity(self.force_task, wrench, tool)
        elif any(self._qd):
            goal = [0.0] * 6
        else:
            return
        k = self._blend
        qd = [v + (g - v) * k for v, g in zip(self._qd, goal, strict=True)]
        if not any(goal) and max(map(abs, qd)) < _STILL:
            qd = [0.0] * 6
        self._qd = qd
        self._arm.drift(qd)

    def _freedrive_velocity(
        self, axes: tuple[bool, ...], wrench: Floats, tool: Transform
    ) -> list[float]:
        if not any(wrench):
            return [0.0] * 6
        matrix = self._kinematics.jacobian(self._arm.target_q, tool)
        if all(axes):
            torque = transpose_multiply(matrix, wrench)
            limits = self._arm.model.torque
            return [
                t / (JOINT_DAMPING_PER_TORQUE * limit)
                for t, limit in zip(torque, limits, strict=True)
            ]
        unlimited = (float("inf"),) * 6
        task = ForceTask(self.freedrive_frame, axes, (0.0,) * 6, unlimited)
        return self._admittance(task, wrench, matrix, 1.0)

    def _force_velocity(self, task: ForceTask, wrench: Floats, tool: Transform) -> list[float]:
        matrix = self._kinematics.jacobian(self._arm.target_q, tool)
        return self._admittance(task, wrench, matrix, self.gain_scaling * (1.0 - self.damping))

    def _admittance(
        self, task: ForceTask, wrench: Floats, matrix: list[list[float]], gain: float
    ) -> list[float]:
        """Joint velocity for the net force along the complying axes of the task frame."""
        local = (*rotate_back(task.frame, wrench[:3]), *rotate_back(task.frame, wrench[3:]))
        speed = []
        for i in range(6):
            if not task.selection[i]:
                speed.append(0.0)
                continue
            damping = LINEAR_DAMPING if i < 3 else ANGULAR_DAMPING
            value = gain * (task.wrench[i] + local[i]) / damping
            speed.append(max(-task.limits[i], min(task.limits[i], value)))
        if not any(speed):
            return [0.0] * 6
        twist = (*rotate(task.frame, speed[:3]), *rotate(task.frame, speed[3:]))
        return solve(matrix, twist) or [0.0] * 6
