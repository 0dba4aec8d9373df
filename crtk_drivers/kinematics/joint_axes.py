"""The axes of a device's joints as a chain that can be drawn, from what its kinematics answer.

Any device with revolute joints in a row has such a chain, wherever its kinematics come from: the column of
a joint in the Jacobian is its axis. Lengths in m, angles in rad.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.device import Device, Kinematics
from crtk_drivers.errors import CrtkError
from crtk_drivers.geometry.frames import inverse_pose
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.kinematics.chain import JointKind, placed, turn
from crtk_drivers.samples import Array, Pose, Vector, vector

logger = logging.getLogger(__name__)

PARALLEL: Final = 0.05
"""Sine of the angle between two axes under which they count as parallel: where they meet tells nothing."""
AGREES: Final = 1e-4
"""Difference, in m and of direction cosines, by which the chain may miss the device's own kinematics."""
SHORTEST: Final = 1e-3
"""Length, in m, of an arm that can be drawn."""

_UNITS: Final = {JointKind.REVOLUTE: "rad", JointKind.PRISMATIC: "m", None: ""}
_PROBES: Final = 3
_UNIT: Final = 1e-3  # by which the length of a joint's axis may differ from 1


@dataclass(frozen=True, slots=True, eq=False)
class RevoluteChain:
    """Joints that turn about z of their frames.

    Attributes:
        joints: transforms (4, 4), each from the link before it, or the device's own base, at position 0.
        tip: from the last link to the tool point.
    """

    joints: tuple[Array, ...]
    tip: Array

    def tool(self, q: Vector) -> Array:
        """Return where the tool point is (4, 4) in the device's own base."""
        found = np.eye(4)
        for joint, angle in zip(self.joints, q.tolist(), strict=True):
            found = found @ joint @ _turned(angle)
        tool: Array = found @ self.tip
        return tool


def joint_kinds(device: Device) -> tuple[JointKind | None, ...]:
    """Return how each joint moves; None where the device's kinematics do not tell, or fail in any way."""
    count, kinematics = len(device.capabilities.joints), device.kinematics
    if not count or kinematics is None:
        return (None,) * count
    try:
        kinds = tuple(_kind(column) for column in kinematics.jacobian(start_of(device)).T)
        if len(kinds) != count:
            raise ValueError(f"its Jacobian has {len(kinds)} columns for {count} joints")
    except Exception as error:  # of a stranger's kinematics, and how joints move is only shown
        logger.debug("%s: how its joints move is not known: %r", device.address, error)
        return (None,) * count
    return kinds


def joint_units(device: Device) -> tuple[str, ...]:
    """Return the unit of each joint's position: ``rad``, ``m``, what the device says, or empty: not known."""
    return device.capabilities.joint_units or tuple(_UNITS[each] for each in joint_kinds(device))


def chain_of(device: Device) -> RevoluteChain | None:
    """Return the chain of a device; None if it has none, as with a joint that slides.

    Only a chain that leads to the poses that the device itself computes is returned.
    """
    kinds, kinematics = joint_kinds(device), device.kinematics
    if not kinds or any(kind is not JointKind.REVOLUTE for kind in kinds) or kinematics is None:
        return None
    back = _into_base(device)
    try:
        chain = _chain(kinematics, back, start_of(device))
        poses = [(probe, _tool(kinematics, back, probe)) for probe in probes_of(device)]
    except CrtkError:
        return None
    lengths = [float(np.linalg.norm(each[:3, 3])) for each in (*chain.joints[2:], chain.tip)]
    agrees = all(np.abs(chain.tool(probe) - pose).max() < AGREES for probe, pose in poses)
    return chain if agrees and sum(lengths) > SHORTEST else None


def _chain(kinematics: Kinematics, back: Array, q: Vector) -> RevoluteChain:
    """Return the chain by the axes at `q`; `back` is from `_into_base`."""
    tool, jacobian = _tool(kinematics, back, q), kinematics.jacobian(q)
    linear, angular = back[:3, :3] @ jacobian[:3], back[:3, :3] @ jacobian[3:]
    joints: list[Array] = []
    before = np.eye(4)
    for column, angle in enumerate(q.tolist()):
        axis = angular[:, column]
        on_axis = tool[:3, 3] + np.cross(axis, linear[:, column])
        frame = frame_on_axis(before, axis, on_axis)
        joints.append(np.linalg.inv(before) @ frame @ _turned(-angle))
        before = frame
    return RevoluteChain(tuple(joints), np.linalg.inv(before) @ tool)


def frame_on_axis(before: Array, axis: Vector, on_axis: Vector) -> Array:
    """Return a frame (4, 4) whose z is an axis, where the axis z of the frame before comes nearest to it.

    Args:
        before: frame (4, 4).
        axis: of unit length.
        on_axis: a point of it.
    """
    last, origin = before[:3, 2], before[:3, 3]
    across = np.cross(last, axis)
    square = float(across @ across)
    if square < PARALLEL**2:
        along = float((origin - on_axis) @ axis)
    else:
        along = float(np.cross(origin - on_axis, last) @ across) / -square
    x = before[:3, 0] - (before[:3, 0] @ axis) * axis
    if np.linalg.norm(x) < PARALLEL:
        x = np.cross(before[:3, 1], axis)
    x /= np.linalg.norm(x)
    rotation = np.column_stack((x, np.cross(axis, x), axis))
    return placed(rotation, (on_axis + along * axis).tolist())


def start_of(device: Device) -> Vector:
    """Return the joint position nearest to zero within the limits."""
    return _within(device, [0.0] * len(device.capabilities.joints))


def probes_of(device: Device) -> list[Vector]:
    """Return joint positions within the limits at which kinematics can be compared."""
    count = len(device.capabilities.joints)
    return [
        _within(device, [math.sin(1.0 + 2.0 * joint + probe) for joint in range(count)])
        for probe in range(_PROBES)
    ]


def _within(device: Device, q: Sequence[float]) -> Vector:
    limits = device.capabilities.limits
    return vector(np.clip(q, [each.lower for each in limits], [each.upper for each in limits]))


def _kind(column: Vector) -> JointKind | None:
    linear, angular = (float(np.linalg.norm(part)) for part in (column[:3], column[3:]))
    if abs(angular - 1.0) < _UNIT:
        return JointKind.REVOLUTE
    return JointKind.PRISMATIC if angular < _UNIT and abs(linear - 1.0) < _UNIT else None


def _into_base(device: Device) -> Array:
    """Return the transform (4, 4) from the base frame into the device's own base."""
    pose = device.capabilities.base_pose
    return np.eye(4) if pose is None else matrix_of(inverse_pose(pose))


def _tool(kinematics: Kinematics, back: Array, q: Vector) -> Array:
    """Return the tool point (4, 4) in the device's own base."""
    tool: Array = back @ matrix_of(kinematics.forward(q))
    return tool


def matrix_of(pose: Pose) -> Array:
    """Return a pose as a transform (4, 4)."""
    return placed(matrix_from_quaternion(pose.orientation), pose.position.tolist())


def _turned(angle: float) -> Array:
    return placed(turn(2, angle), (0.0, 0.0, 0.0))
