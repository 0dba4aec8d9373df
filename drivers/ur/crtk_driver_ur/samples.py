"""From a state of the controller to a CRTK sample. Units are SI on both sides; only forms change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from crtk_driver_ur.frames import BASE_FRAME, IDENTITY, Transform, compose, inverse, pose_of
from crtk_driver_ur.models import JOINT_NAMES
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_drivers.samples import (
    JointState,
    OnDemand,
    Pose,
    Sample,
    Stamp,
    Twist,
    Value,
    Wrench,
    parts,
)

Vector3: TypeAlias = tuple[float, float, float]

TOOL_FRAME = "tool0"

SAME_TOOL = 1e-4
"""m and rad by which a tool may differ from what the controller makes of it."""


class _Reading:
    """What the values of a sample are made from.

    Args:
        state: of the controller.
        shift: from its tool point to ours; None if they are one.
    """

    def __init__(self, state: StateSample, shift: Transform | None) -> None:
        self.state = state
        self.shift = shift

    def shifted(self, pose: Sequence[float]) -> Transform:
        """Return the pose of our tool point where `pose` is the controller's."""
        transform = Transform.from_pose_vector(pose)
        return transform if self.shift is None else compose(transform, self.shift)

    @cached_property
    def tool(self) -> Transform:
        """Where our tool point is."""
        return self.shifted(self.state.actual_TCP_pose)

    @property
    def arm(self) -> Vector3 | None:
        """The way from the controller's tool point to ours, base axes; None if they are one."""
        if self.shift is None:
            return None
        x, y, z = self.state.actual_TCP_pose[:3]
        return self.tool.x - x, self.tool.y - y, self.tool.z - z


def _measured_js(reading: _Reading) -> JointState:
    state = reading.state
    torque = state.actual_current_as_torque or ()
    numbers = (*state.actual_q, *state.actual_qd, *torque)
    position, velocity, effort = parts(numbers, 6, 6, len(torque))
    return JointState(position, velocity, effort, JOINT_NAMES)


def _setpoint_js(reading: _Reading) -> JointState:
    state = reading.state
    numbers = (*state.target_q, *state.target_qd, *state.target_moment)
    position, velocity, effort = parts(numbers, 6, 6, 6)
    return JointState(position, velocity, effort, JOINT_NAMES)


def _measured_cp(reading: _Reading) -> Pose:
    return pose_of(reading.tool)


def _setpoint_cp(reading: _Reading) -> Pose:
    return pose_of(reading.shifted(reading.state.target_TCP_pose))


def _measured_cv(reading: _Reading) -> Twist:
    speed, arm = reading.state.actual_TCP_speed, reading.arm
    linear, angular = speed[:3], speed[3:]
    if arm is not None:
        linear = _plus_cross(linear, angular, arm)
    v, w = parts((*linear, *angular), 3, 3)
    return Twist(v, w, BASE_FRAME)


def _measured_cf(reading: _Reading) -> Wrench:
    wrench, arm = reading.state.actual_TCP_force, reading.arm
    force, torque = wrench[:3], wrench[3:]
    if arm is not None:
        torque = _plus_cross(torque, force, arm)
    f, t = parts((*force, *torque), 3, 3)
    return Wrench(f, t, BASE_FRAME)


_MAKERS: Mapping[str, Callable[[_Reading], Value]] = MappingProxyType(
    {
        "measured_js": _measured_js,
        "measured_cp": _measured_cp,
        "measured_cv": _measured_cv,
        "measured_cf": _measured_cf,
        "setpoint_js": _setpoint_js,
        "setpoint_cp": _setpoint_cp,
    }
)


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
        reading = _Reading(state, self._shift_to_tool(state))
        return Sample(Stamp.at(made), OnDemand(_MAKERS, reading))

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


def _plus_cross(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> Vector3:
    """Return a + b x c: how a velocity or a torque is carried over to the end of the arm c."""
    ax, ay, az = a
    bx, by, bz = b
    cx, cy, cz = c
    return ax + by * cz - bz * cy, ay + bz * cx - bx * cz, az + bx * cy - by * cx
