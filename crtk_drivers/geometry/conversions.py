"""Poses as other libraries write them. Each library is imported when it is asked for.

Pose (ours)      position (3,) in m, orientation (4,) x, y, z, w
PyKDL.Frame      Debian: python3-pykdl
pinocchio.SE3    pip: pin
scipy Rotation   with a position beside it
numpy            (4, 4) homogeneous, or 7 numbers: position and quaternion x, y, z, w
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from crtk_drivers.errors import MissingExtra
from crtk_drivers.geometry.quaternions import (
    QUATERNION_TOLERANCE,
    matrix_from_quaternion,
    quaternion_from_matrix,
)
from crtk_drivers.samples import Array, Pose, vector


def as_pose(value: Any, frame_id: str = "") -> Pose:
    """Return the pose of a Pose, PyKDL.Frame, pinocchio.SE3, (4, 4) matrix or 7 numbers.

    Raises:
        TypeError, ValueError: it is none of these.
    """
    if isinstance(value, Pose):
        return value
    if hasattr(value, "M") and hasattr(value, "p"):
        position = [float(value.p[axis]) for axis in range(3)]
        return Pose(vector(position), vector(value.M.GetQuaternion()), frame_id)
    if hasattr(value, "homogeneous"):
        value = value.homogeneous
    numbers = np.asarray(value, dtype=np.float64)
    if numbers.shape == (7,):
        return Pose(vector(numbers[:3]), vector(numbers[3:]), frame_id)
    if numbers.shape == (4, 4):
        if not np.allclose(numbers[3], (0.0, 0.0, 0.0, 1.0)):
            raise ValueError("the last row of a homogeneous matrix is 0 0 0 1")
        rotation = numbers[:3, :3]
        is_rotation = np.allclose(rotation @ rotation.T, np.eye(3), atol=QUATERNION_TOLERANCE)
        if not (is_rotation and np.linalg.det(rotation) > 0.0):
            raise ValueError("its upper left 3 x 3 is no rotation")
        return Pose(vector(numbers[:3, 3]), quaternion_from_matrix(numbers[:3, :3]), frame_id)
    raise ValueError(f"an array of shape {numbers.shape} is no pose")


def to_matrix(pose: Pose) -> Array:
    """Return the homogeneous matrix (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quaternion(pose.orientation)
    matrix[:3, 3] = pose.position
    return matrix


def have_kdl() -> bool:
    """Whether PyKDL is installed."""
    try:
        import PyKDL  # noqa: F401 - is it there?
    except ImportError:
        return False
    return True


def to_kdl(pose: Pose) -> Any:
    """Return a PyKDL.Frame.

    Raises:
        MissingExtra: PyKDL is not installed.
    """
    try:
        import PyKDL
    except ImportError:
        raise MissingExtra(
            "PyKDL",
            "",
            remedy="For the system's Python: sudo apt install python3-pykdl. Others use to_matrix.",
        ) from None

    return PyKDL.Frame(
        PyKDL.Rotation.Quaternion(*pose.orientation.tolist()),
        PyKDL.Vector(*pose.position.tolist()),
    )


def to_se3(pose: Pose) -> Any:
    """Return a pinocchio.SE3.

    Raises:
        MissingExtra: pinocchio is not installed.
    """
    try:
        import pinocchio
    except ImportError:
        raise MissingExtra("pinocchio", "kinematics") from None

    return pinocchio.SE3(matrix_from_quaternion(pose.orientation), np.array(pose.position))


def to_rotation(pose: Pose) -> Any:
    """Return the orientation as a scipy.spatial.transform.Rotation.

    Raises:
        MissingExtra: scipy is not installed.
    """
    try:
        from scipy.spatial.transform import Rotation
    except ImportError:
        raise MissingExtra("scipy", "", remedy="Install it with: pip install scipy") from None

    return Rotation.from_quat(pose.orientation)


def from_rotation(position: ArrayLike, rotation: Any, frame_id: str = "") -> Pose:
    """Return the pose of a position (3,) and a scipy Rotation."""
    return Pose(vector(position), vector(rotation.as_quat()), frame_id)
