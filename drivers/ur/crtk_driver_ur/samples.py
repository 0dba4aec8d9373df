"""From a state of the controller to a CRTK sample. Units are SI on both sides; only forms change."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from crtk_driver_ur.frames import BASE_FRAME, IDENTITY, Transform, compose, inverse
from crtk_driver_ur.models import JOINT_NAMES
from crtk_driver_ur.rtde.stream import StateSample
from crtk_drivers.samples import JointState, Pose, Sample, Stamp, Twist, Value, Wrench, parts

Vector3: TypeAlias = tuple[float, float, float]

TOOL_FRAME = "tool0"

SAME_TOOL = 1e-4
"""m and rad by which a tool may differ from what the controller makes of it."""


class SampleMaker:
    """Makes samples; the tool centre point may be one that the controller does not have (yet).

    Args:
        tool: flange to tool centre point; None takes the controller's.
    """

    def __init__(self, tool: Transform | None) -> None:
        self._tool = tool
        self._reported: tuple[float, ...] | None = None
        self._shift: Transform | None = None

    def make(self, state: StateSample, late: float = 0.0) -> Sample:
        """Return measured_js, _cp, _cv, _cf and the controller's setpoint_js, _cp of one state.

        It was made `late` seconds before it was received.

        Effort is in N·m and is the torque that the controller reports for the joints' motors; where
        the controller reports amperes only it is empty. The setpoint's effort is the controller's own
        target torque.
        """
        made = state.received - late
        wall = time.time_ns() - int((time.monotonic() - made) * 1e9)
        torque = state.actual_current_as_torque
        shift = self._shift_to_tool(state)
        tool, goal = _shifted(state.actual_TCP_pose, shift), _shifted(state.target_TCP_pose, shift)
        speed, force = state.actual_TCP_speed, state.actual_TCP_force
        linear, angular, forces, torques = speed[:3], speed[3:], force[:3], force[3:]
        if shift is not None:
            x, y, z = state.actual_TCP_pose[:3]
            arm = (tool.x - x, tool.y - y, tool.z - z)
            linear = _plus_cross(linear, angular, arm)
            torques = _plus_cross(torques, forces, arm)
        numbers = (
            *(*state.actual_q, *state.actual_qd, *(torque or ())),
            *(*state.target_q, *state.target_qd, *state.target_moment),
            *(*tool.position, *tool.quaternion(), *linear, *angular, *forces, *torques),
            *(*goal.position, *goal.quaternion()),
        )
        q, qd, effort, *setpoint, at, turned, v, w, f, t, to_at, to_turned = parts(
            numbers, 6, 6, 6 if torque else 0, 6, 6, 6, 3, 4, 3, 3, 3, 3, 3, 4
        )
        values: dict[str, Value] = {
            "measured_js": JointState(q, qd, effort, JOINT_NAMES),
            "setpoint_js": JointState(*setpoint, JOINT_NAMES),
            "measured_cp": Pose(at, turned, BASE_FRAME),
            "setpoint_cp": Pose(to_at, to_turned, BASE_FRAME),
            "measured_cv": Twist(v, w, BASE_FRAME),
            "measured_cf": Wrench(f, t, BASE_FRAME),
        }
        return Sample(Stamp(wall, made), values)

    @property
    def has_tool_of_controller(self) -> bool:
        """Whether the tool centre point is the one that the controller reported last, if it did."""
        return self._shift is None or np.allclose(self._shift, IDENTITY, atol=SAME_TOOL)

    def _shift_to_tool(self, state: StateSample) -> Transform | None:
        """Return the transform from the controller's tool point to ours, None if they are one."""
        if self._tool is None or state.tcp_offset is None:
            return None
        if state.tcp_offset != self._reported:
            self._reported = state.tcp_offset
            reported = Transform.from_pose_vector(state.tcp_offset)
            shift = compose(inverse(reported), self._tool)
            same = np.allclose(reported, self._tool, atol=1e-12)
            self._shift = None if same else shift
        return self._shift


def _shifted(pose: tuple[float, ...], shift: Transform | None) -> Transform:
    transform = Transform.from_pose_vector(pose)
    return transform if shift is None else compose(transform, shift)


def _plus_cross(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> Vector3:
    """Return a + b x c: how a velocity or a torque is carried over to the end of the arm c."""
    ax, ay, az = a
    bx, by, bz = b
    cx, cy, cz = c
    return ax + by * cz - bz * cy, ay + bz * cx - bx * cz, az + bx * cy - by * cx
