"""The URScript built-ins that compute with poses, wrenches and orientations (module "urmath")."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from crtk_sim_backends.ur.motion import kinematics as k
from crtk_sim_backends.ur.urscript import PURE_BUILTINS, Builtin, List, Pose
from crtk_sim_backends.ur.urscript.arguments import six, vector


def pose_builtins() -> Iterator[Builtin]:
    """Every built-in of this module."""
    for call in (
        interpolate_pose,
        inv,
        pose_add,
        pose_dist,
        pose_inv,
        pose_sub,
        pose_trans,
        rotvec2rpy,
        rpy2rotvec,
        wrench_trans,
    ):
        yield Builtin(call.__name__, call)


def pose_trans(p_from: Any, p_from_to: Any) -> Pose:
    """Pose ``p_from_to``, which is relative to ``p_from``."""
    return Pose(k.pose_trans(six("pose_trans", p_from), six("pose_trans", p_from_to)))


def pose_inv(p_from: Any) -> Pose:
    """Inverse of a pose."""
    return Pose(k.pose_inv(six("pose_inv", p_from)))


def pose_add(p_1: Any, p_2: Any) -> Pose:
    """Sum of the positions with the product of the rotations."""
    return Pose(k.pose_add(six("pose_add", p_1), six("pose_add", p_2)))


def pose_sub(p_to: Any, p_from: Any) -> Pose:
    """Difference of the positions with the rotation between the orientations."""
    return Pose(k.pose_sub(six("pose_sub", p_to), six("pose_sub", p_from)))


def pose_dist(p_from: Any, p_to: Any) -> float:
    """Distance of two poses."""
    return k.pose_distance(six("pose_dist", p_from), six("pose_dist", p_to))


def interpolate_pose(p_from: Any, p_to: Any, alpha: float) -> Pose:
    """Pose at ``alpha`` (0 to 1, or beyond) of the way between two."""
    a, b = six("interpolate_pose", p_from), six("interpolate_pose", p_to)
    return Pose(k.interpolate_pose(a, b, alpha))


def inv(m: Any) -> List:
    """Inverse of a pose or of a square matrix."""
    if isinstance(m, Pose):
        return pose_inv(m)
    return PURE_BUILTINS["inv"].call(m)  # type: ignore[no-any-return]


def rotvec2rpy(rotation_vector: Any) -> List:
    """Roll, pitch and yaw (rad, about the fixed x, y and z axes in turn) of a rotation vector."""
    m = k.rotation_matrix(*vector("rotvec2rpy", rotation_vector, 3))
    pitch = math.atan2(-m[6], math.hypot(m[0], m[3]))
    if math.hypot(m[0], m[3]) < 1e-9:  # straight up or down: yaw is free
        return List([math.atan2(-m[5], m[4]), pitch, 0.0])
    return List([math.atan2(m[7], m[8]), pitch, math.atan2(m[3], m[0])])


def rpy2rotvec(rpy_vector: Any) -> List:
    """Rotation vector of roll, pitch and yaw: the rotation Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = vector("rpy2rotvec", rpy_vector, 3)
    turns = ((0.0, 0.0, yaw), (0.0, pitch, 0.0), (roll, 0.0, 0.0))
    x, y, z = (k.to_transform((0.0, 0.0, 0.0, *turn)) for turn in turns)
    return List(k.to_pose(k.compose(k.compose(x, y), z))[3:])


def wrench_trans(T_from_to: Any, w_from: Any) -> List:  # noqa: N803
    """See a wrench from another frame: ``T_from_to`` is where the frame of ``w_from`` is in it.

    The manual gives no more than ``w_to = T w_from``; UR's examples of admittance and of impedance
    control use the function in this direction.
    """
    t = k.to_transform(six("wrench_trans", T_from_to))
    wrench = six("wrench_trans", w_from)
    force = k.rotate(t, wrench[:3])
    torque = k.rotate(t, wrench[3:])
    arm = k.cross(k.to_pose(t)[:3], force)
    return List([*force, *(a + b for a, b in zip(torque, arm, strict=True))])
