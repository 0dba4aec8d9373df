"""Many poses, or points, as arrays: what all calibrations begin with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crtk_drivers.errors import CalibrationError
from crtk_drivers.geometry.conversions import to_matrix
from crtk_drivers.geometry.quaternions import QUATERNION_TOLERANCE, unit
from crtk_drivers.samples import Array, Pose, vector


def stacked(poses: Sequence[Pose], least: int, what: str) -> Array:
    """Return poses as homogeneous matrices (n, 4, 4), in m.

    Raises:
        CalibrationError: fewer than `least`, or one that is no pose.
    """
    if len(poses) < least:
        raise CalibrationError(
            f"{len(poses)} {what} are too few", remedy=f"Take at least {least} of them."
        )
    numbers = np.array([(*pose.position, *pose.orientation) for pose in poses])
    norms = np.linalg.norm(numbers[:, 3:], axis=1)
    wrong = ~np.isfinite(numbers).all(axis=1) | ~(np.abs(norms - 1.0) < QUATERNION_TOLERANCE)
    if wrong.any():
        raise CalibrationError(
            f"number {int(wrong.argmax()) + 1} of the {what} is no pose",
            remedy="Leave it out: its numbers are not finite, or its quaternion has no norm of 1.",
        )
    return np.array([to_matrix(Pose(p.position, unit(p.orientation))) for p in poses])


def points_of(values: Sequence[Sequence[float]] | Array, what: str) -> Array:
    """Return points as an array (n, 3), in m.

    Raises:
        CalibrationError: they are none.
    """
    points = np.asarray(values, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise CalibrationError(
            f"the {what} are no points: their shape is {points.shape}, or a number is not finite",
            remedy="Give x, y, z of each in m.",
        )
    return points


def inverse(transforms: Array) -> Array:
    """Return the inverses of rigid transforms (..., 4, 4)."""
    turned = np.swapaxes(transforms[..., :3, :3], -1, -2)
    result = np.zeros_like(transforms)
    result[..., :3, :3] = turned
    result[..., :3, 3] = -(turned @ transforms[..., :3, 3:])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def angles(rotations: Array) -> Array:
    """Return by how much each rotation matrix (..., 3, 3) turns, in rad, from 0 to pi."""
    skew = rotations - np.swapaxes(rotations, -1, -2)
    sine = 0.5 * np.sqrt(skew[..., 2, 1] ** 2 + skew[..., 0, 2] ** 2 + skew[..., 1, 0] ** 2)
    cosine = 0.5 * (np.trace(rotations, axis1=-2, axis2=-1) - 1.0)
    result: Array = np.arctan2(sine, cosine)
    return result


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotation (3, 3) nearest to a matrix, no reflection (Kabsch 1976; Umeyama 1991)."""
    left, _, right = np.linalg.svd(matrix)
    sign = np.sign(np.linalg.det(left @ right))
    rotation: Array = left @ np.diag((1.0, 1.0, sign)) @ right
    return rotation


def mean_transform(transforms: Array) -> Array:
    """Return the mean of rigid transforms (n, 4, 4): of positions, and the chordal mean of rotations."""
    mean = np.eye(4)
    mean[:3, :3] = nearest_rotation(transforms[:, :3, :3].mean(axis=0))
    mean[:3, 3] = transforms[:, :3, 3].mean(axis=0)
    return mean


def mean_pose(poses: Sequence[Pose]) -> Pose:
    """Return the mean of poses that are near each other, in the frame of the first."""
    numbers = np.array([pose.orientation for pose in poses])
    signs = np.where(numbers @ numbers[0] < 0.0, -1.0, 1.0)
    position = np.mean([pose.position for pose in poses], axis=0)
    turned = unit(vector((numbers * signs[:, None]).sum(axis=0)))
    return Pose(vector(position), turned, poses[0].frame_id)


def rms(values: Array) -> float:
    """Return the root of the mean of squares."""
    return float(np.sqrt(np.mean(np.square(values))))
