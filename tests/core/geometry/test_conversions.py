"""Poses of other libraries, there and back."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.errors import MissingExtra
from crtk_drivers.geometry import conversions
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.samples import Pose

coordinates = st.floats(-2.0, 2.0)


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    quaternion = np.array([draw(coordinates) for _ in range(4)])
    norm = float(np.linalg.norm(quaternion))
    unit = quaternion / norm if norm > 1e-2 else np.array([0.0, 0.0, 0.0, 1.0])
    return Pose(np.array([draw(coordinates) for _ in range(3)]), unit, "base")


def same(a: Pose, b: Pose) -> bool:
    turned = abs(float(a.orientation @ b.orientation))
    return np.allclose(a.position, b.position) and math.isclose(turned, 1.0, abs_tol=1e-9)


def seven(pose: Pose) -> Any:
    return [*pose.position, *pose.orientation]


@given(pose=poses())
@pytest.mark.parametrize("convert", [seven, conversions.to_matrix, lambda pose: pose])
def test_numpy_there_and_back(convert: Callable[[Pose], Any], pose: Pose) -> None:
    assert same(conversions.as_pose(convert(pose), "base"), pose)


@pytest.mark.parametrize(
    ("module", "convert"),
    [("PyKDL", conversions.to_kdl), ("pinocchio", conversions.to_se3)],
)
def test_a_librarys_frame_there_and_back(module: str, convert: Callable[[Pose], Any]) -> None:
    pytest.importorskip(module)
    pose = Pose(np.array([0.1, -0.2, 0.3]), np.array([0.5, -0.5, 0.5, 0.5]))
    assert same(conversions.as_pose(convert(pose)), pose)


@pytest.mark.parametrize(
    ("module", "convert", "remedy"),
    [
        (
            "PyKDL",
            conversions.to_kdl,
            "For the system's Python: sudo apt install python3-pykdl. Others use to_matrix.",
        ),
        (
            "pinocchio",
            conversions.to_se3,
            "Install it with: pip install 'crtk-drivers[kinematics]'",
        ),
        (
            "scipy.spatial.transform",
            conversions.to_rotation,
            "Install it with: pip install scipy",
        ),
    ],
)
def test_a_library_that_is_missing_is_named_with_how_to_install_it(
    module: str, convert: Callable[[Pose], Any], remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtra, match="is not installed") as raised:
        convert(Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])))
    assert raised.value.remedy == remedy


def test_scipy_there_and_back() -> None:
    pytest.importorskip("scipy")
    pose = Pose(np.array([0.1, -0.2, 0.3]), np.array([0.5, -0.5, 0.5, 0.5]))
    rotation = conversions.to_rotation(pose)
    assert np.allclose(rotation.as_matrix(), matrix_from_quaternion(pose.orientation))
    assert same(conversions.from_rotation(pose.position, rotation), pose)


class Frame:
    """What PyKDL.Frame looks like from outside."""

    class Rotation:
        def GetQuaternion(self) -> tuple[float, ...]:  # noqa: N802 - KDL's name
            return (0.0, 0.0, 1.0, 0.0)

    M = Rotation()
    p = (0.1, 0.2, 0.3)


def test_a_frame_with_p_and_m_is_a_pose() -> None:
    pose = conversions.as_pose(Frame(), "base")
    assert same(pose, Pose(np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 1.0, 0.0])))
    assert pose.frame_id == "base"


@pytest.mark.parametrize("value", [[1.0] * 6, np.zeros((3, 3)), np.ones((4, 4)), "here", None])
def test_what_is_no_pose(value: Any) -> None:
    with pytest.raises((TypeError, ValueError)):
        conversions.as_pose(value)


@pytest.mark.parametrize(
    ("matrix", "text"),
    [
        (np.zeros((4, 4)), "last row"),
        (np.diag((0.0, 0.0, 0.0, 1.0)), "no rotation"),
        (np.diag((2.0, 1.0, 1.0, 1.0)), "no rotation"),
        (np.diag((-1.0, 1.0, 1.0, 1.0)), "no rotation"),
    ],
)
def test_a_matrix_that_is_no_pose_is_refused(matrix: np.ndarray, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        conversions.as_pose(matrix)
