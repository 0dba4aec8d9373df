"""The chain of any device, found from what its kinematics answer: joints that turn or slide, in a row.

At one joint position the tool pose and the axes of the joints, which are the columns of the Jacobian, say all
of a serial arm (product of exponentials: Lynch and Park, Modern Robotics, section 4.1). So what a driver has
calibrated, a URDF, a DH table and a tool that is mounted all come out the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from crtk_drivers.device import Device, Kinematics
from crtk_drivers.errors import CrtkError
from crtk_drivers.geometry.quaternions import matrix_from_quaternion, quaternion_from_rotvec
from crtk_drivers.kinematics.chain import Chain, ChainJoint, JointKind, placed
from crtk_drivers.kinematics.joint_axes import joint_kinds, matrix_of, probes_of, start_of
from crtk_drivers.samples import Array, Vector, vector

__all__ = ["found_chain", "tool_of"]

AGREES: Final = 1e-7
"""Difference, in m and of direction cosines, by which the chain may miss the device's own kinematics."""

_STEP: Final = 0.1
"""rad or m by which a joint is moved to see which others it carries."""
_CARRIED: Final = 1e-6
"""Change of an axis from which on it counts as carried."""


def found_chain(device: Device) -> Chain | None:
    """Return the chain from a device's base frame to its tool frame, by the kinematics in force.

    None if it has none, or is no chain: the one that is returned leads where the device's own kinematics do.
    """
    kinds, kinematics = joint_kinds(device), device.kinematics
    known = [kind for kind in kinds if kind is not None]
    if not known or len(known) < len(kinds) or kinematics is None:
        return None
    try:
        probes = probes_of(device)
        order = _order(device, kinematics, probes[0])
        chain = _chain(device, kinematics, known, order)
        misses = [
            float(np.abs(tool_of(chain, q) - matrix_of(kinematics.forward(q))).max())
            for q in probes
        ]
    except CrtkError:
        return None
    return chain if max(misses) < AGREES else None


def tool_of(chain: Chain, q: Vector) -> Array:
    """Return where the tip is (4, 4) in the base, for joint positions (n,) in the order of `Chain.names`."""
    positions = dict(zip(chain.names, q.tolist(), strict=True))
    found = np.eye(4)
    for joint in chain.joints:
        found = found @ joint.placement @ _moved(joint.kind, joint.axis, positions[joint.name])
    tool: Array = found @ chain.tip
    return tool


def _moved(kind: JointKind, axis: Vector, by: float) -> Array:
    """Return the motion (4, 4) of a joint about or along an axis through the origin."""
    if kind is JointKind.PRISMATIC:
        return placed(np.eye(3), (by * axis).tolist())
    turned = matrix_from_quaternion(quaternion_from_rotvec(vector(by * axis)))
    return placed(turned, (0.0, 0.0, 0.0))


def _order(device: Device, kinematics: Kinematics, q: Vector) -> list[int]:
    """Return the joints from base to tip: each is carried by those before it, and by no others."""
    before = _screws(kinematics, q)
    carried = np.zeros(q.size, dtype=int)
    for joint, limit in enumerate(device.capabilities.limits):
        step = _STEP if q[joint] + _STEP <= limit.upper else -_STEP
        moved = q.copy()
        moved[joint] += step
        change = np.abs(_screws(kinematics, vector(moved)) - before).max(axis=0)
        change[joint] = 0.0
        carried += change > _CARRIED
    return sorted(range(q.size), key=carried.tolist().__getitem__)


def _screws(kinematics: Kinematics, q: Vector) -> Array:
    """Return the axes (6, n) as lines: direction, and moment about the origin of the base frame."""
    jacobian = kinematics.jacobian(q)
    tool = kinematics.forward(q).position
    linear, angular = jacobian[:3], jacobian[3:]
    return np.vstack((angular, linear - np.cross(angular, tool, axisa=0, axisc=0)))


def _chain(
    device: Device, kinematics: Kinematics, kinds: Sequence[JointKind], order: Sequence[int]
) -> Chain:
    """Return the chain whose frames all have the axes of the base frame when the joints are at the start."""
    q = start_of(device)
    jacobian, tool = kinematics.jacobian(q), matrix_of(kinematics.forward(q))
    names, limits = device.capabilities.joints, device.capabilities.limits
    joints = []
    at = np.zeros(3)
    for joint in order:
        linear, angular = jacobian[:3, joint], jacobian[3:, joint]
        if kinds[joint] is JointKind.PRISMATIC:
            axis, here = linear, at
        else:
            axis, on_axis = angular, tool[:3, 3] + np.cross(angular, linear)
            here = on_axis + ((at - on_axis) @ axis) * axis
        placement = placed(np.eye(3), (here - at).tolist())
        placement = placement @ _moved(kinds[joint], axis, -float(q[joint]))
        limit = limits[joint]
        joints.append(
            ChainJoint(names[joint], kinds[joint], placement, axis, limit.lower, limit.upper)
        )
        at = here
    tip = placed(tool[:3, :3], (tool[:3, 3] - at).tolist())
    return Chain(tuple(joints), tip, tuple(names))
