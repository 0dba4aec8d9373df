"""Rotations and rigid transforms on small numpy arrays.

Quaternions are ``x, y, z, w``. Rotation vectors are axis times angle in rad. Matrices act on columns.
"""

from __future__ import annotations

import math

import numpy as np

from crtk_drivers.samples import Array, Pose, Vector, vector

QUATERNION_TOLERANCE = 1e-3
"""A norm further than this from one is no rotation; within it a quaternion is normalised."""


def quaternion_from_rotvec(rotvec: Vector) -> Vector:
    """Return the unit quaternion (4,) of a rotation vector (3,) in rad."""
    x, y, z = rotvec.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    # sin(a/2)/a, by its series where the quotient would lose digits
    scale = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(angle / 2.0) / angle
    return vector((x * scale, y * scale, z * scale, math.cos(angle / 2.0)))


def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Vector:
    """Return the unit quaternion (4,) of turns in rad about fixed x, then y, then z."""
    about_x, about_y, about_z = (
        quaternion_from_rotvec(vector(angle * np.eye(3)[axis]))
        for axis, angle in enumerate((roll, pitch, yaw))
    )
    return quaternion_product(about_z, quaternion_product(about_y, about_x))


def rotvec_from_quaternion(quaternion: Vector) -> Vector:
    """Return the rotation vector (3,) in rad, of at most pi, of a unit quaternion (4,)."""
    x, y, z, w = quaternion.tolist()
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 / w if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return vector((x * scale, y * scale, z * scale))


def quaternion_product(left: Vector, right: Vector) -> Vector:
    """Return the quaternion that rotates by `right` first and by `left` after it."""
    ax, ay, az, aw = left.tolist()
    bx, by, bz, bw = right.tolist()
    return vector(
        (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        )
    )


def unit(quaternion: Vector) -> Vector:
    """Return a quaternion (4,) without what rounding has added to its length."""
    x, y, z, w = quaternion.tolist()
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return vector((x / norm, y / norm, z / norm, w / norm))


def matrix_from_quaternion(quaternion: Vector) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (4,)."""
    x, y, z, w = quaternion.tolist()
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        )
    )


def rotated(quaternion: Vector, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the vector (x, y, z) turned by a unit quaternion (4,)."""
    i, j, k, w = quaternion.tolist()
    a, b, c = 2.0 * (j * z - k * y), 2.0 * (k * x - i * z), 2.0 * (i * y - j * x)
    return x + w * a + j * c - k * b, y + w * b + k * a - i * c, z + w * c + i * b - j * a


def quaternion_from_matrix(rotation: Array) -> Vector:
    """Return the unit quaternion (4,) of a rotation matrix (3, 3), by its largest component."""
    m = rotation.tolist()
    trace = m[0][0] + m[1][1] + m[2][2]
    candidates = (m[0][0], m[1][1], m[2][2], trace)
    largest = max(range(4), key=candidates.__getitem__)
    if largest == 3:
        q = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 1.0 + trace]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        q = [0.0] * 4
        q[i] = 1.0 + m[i][i] - m[j][j] - m[k][k]
        q[j] = m[j][i] + m[i][j]
        q[k] = m[k][i] + m[i][k]
        q[3] = m[k][j] - m[j][k]
    norm = math.sqrt(sum(c * c for c in q))
    return vector([c / norm for c in q])


def pose_from_rotvec(pose: Vector, frame_id: str = "") -> Pose:
    """Return the pose of (6,) position in m and rotation vector in rad."""
    return Pose(vector(pose[:3]), quaternion_from_rotvec(vector(pose[3:])), frame_id)


def rotvec_from_pose(pose: Pose) -> Vector:
    """Return (6,) position in m and rotation vector in rad of a pose."""
    return vector(np.concatenate((pose.position, rotvec_from_quaternion(pose.orientation))))
