"""Where a tracker stands to an arm, and where its marker sits on the arm's flange.

While the arm stands in poses A_i (flange in the arm's base), the tracker tells B_i (marker in the tracker):
``A_i · X = Y · B_i``, X the marker in the flange, Y the tracker in the arm's base. Between two poses Y falls
out: ``A · X = X · B``. X by Tsai and Lenz (IEEE T-RA 5, 1989) and by Park and Martin (IEEE T-RA 10, 1994).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from crtk_drivers.errors import CalibrationError
from crtk_drivers.geometry.conversions import as_pose
from crtk_drivers.labs.calibration.stacks import (
    angles,
    inverse,
    mean_transform,
    nearest_rotation,
    rms,
    stacked,
)
from crtk_drivers.samples import Array, Pose

Method = Literal["park", "tsai"]

LEAST: Final = 5
"""Pairs of poses."""
MOST: Final = 200
"""Pairs of poses; the motions between any two of them are used."""
SMALLEST: Final = np.radians(8.0)
"""Turn between two poses that tells an axis."""
LARGEST: Final = np.radians(172.0)
"""The same; beyond it the sign of the axis is left to noise."""
LEAST_SPREAD: Final = 0.15
"""Of the axes: of how far they point one way, what they must point another."""
UNLIKE: Final = np.radians(4.0)
"""How differently arm and marker may turn, in the median: more, and they are not one body at one time."""
WORST: Final = 10e-3
"""m RMS."""


@dataclass(frozen=True, slots=True, eq=False)
class HandEye:
    """A tracker and an arm.

    Attributes:
        marker: pose of the marker in the arm's flange: X.
        tracker: pose of the tracker in the arm's base: Y.
        residual: m RMS between where the arm says that the marker is, and the tracker.
        turned: rad RMS, the same of orientations.
        residuals: (n, 2) of each pair: m, rad.
        spread: from 0 (the arm turned about one axis only) to 1 (about all alike).
        unlike: rad, the median difference of how far the arm turned and how far the marker did.
        motions: that were used.
    """

    marker: Pose
    tracker: Pose
    residual: float
    turned: float
    residuals: Array
    spread: float
    unlike: float
    motions: int


def hand_eye(
    arm: Sequence[Pose],
    marker: Sequence[Pose],
    method: Method = "park",
    worst: float = WORST,
    unlike: float = UNLIKE,
) -> HandEye:
    """Return where tracker and marker are.

    Args:
        arm: poses of the flange in the arm's base.
        marker: poses of the marker in the tracker, each at the same time as that of the arm.
        method: how the rotation is found.
        worst: residual in m beyond which they are refused.
        unlike: rad by which arm and marker may turn differently, in the median, before they are refused.

    Raises:
        CalibrationError: too few pairs, poses that are none, turns that are too small or about one axis, an
            arm and a marker that do not move together, or a residual beyond `worst`.
    """
    if len(arm) != len(marker) or len(arm) > MOST:
        raise CalibrationError(
            f"{len(arm)} poses of the arm and {len(marker)} of the marker",
            remedy=f"Give as many of one as of the other, and {MOST} at the most.",
        )
    arms, markers = stacked(arm, LEAST, "poses"), stacked(marker, LEAST, "poses")
    first, second = np.triu_indices(len(arms), 1)
    moved = inverse(arms)[second] @ arms[first]
    seen = inverse(markers)[second] @ markers[first]
    by_arm, by_marker = angles(moved[:, :3, :3]), angles(seen[:, :3, :3])
    differ = float(np.median(np.abs(by_arm - by_marker)))
    used = (np.minimum(by_arm, by_marker) > SMALLEST) & (np.maximum(by_arm, by_marker) < LARGEST)
    spread = _spread(moved[used])
    if spread < LEAST_SPREAD:
        raise CalibrationError(
            f"the arm hardly turned, or about one axis only ({int(used.sum())} of {len(used)} motions "
            f"are of use; spread {spread:.2f} of at least {LEAST_SPREAD:g})",
            remedy="Turn the flange by 30° or more about different axes from pose to pose.",
        )
    if differ > unlike:
        raise CalibrationError(
            f"arm and marker did not turn alike: {np.degrees(differ):.1f}° apart in the median",
            remedy="Is the marker fixed to this arm, and was each pair taken while both stood?",
        )
    x = np.eye(4)
    x[:3, :3] = ROTATIONS[method](moved[used], seen[used])
    x[:3, 3] = _translation(moved[used], seen[used], x[:3, :3])
    y = mean_transform(arms @ x @ inverse(markers))
    off = inverse(arms @ x) @ (y @ markers)
    residuals = np.stack((np.linalg.norm(off[:, :3, 3], axis=1), angles(off[:, :3, :3])), axis=1)
    residual = rms(residuals[:, 0])
    if not residual <= worst:
        raise CalibrationError(
            f"residual {1e3 * residual:.2f} mm RMS, {1e3 * residuals[:, 0].max():.2f} mm at pair "
            f"{int(residuals[:, 0].argmax()) + 1}",
            remedy=f"Leave that pair out, or take them anew; {1e3 * worst:g} mm are allowed.",
        )
    return HandEye(
        as_pose(x),
        as_pose(y),
        residual,
        rms(residuals[:, 1]),
        residuals,
        spread,
        differ,
        int(used.sum()),
    )


def _axes(transforms: Array) -> Array:
    """Return the axes (n, 3) of rotations, of length 1; their angles are neither 0 nor pi."""
    rotations = transforms[:, :3, :3]
    skew = rotations - np.swapaxes(rotations, 1, 2)
    along = np.stack((skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]), axis=1)
    result: Array = along / np.linalg.norm(along, axis=1, keepdims=True)
    return result


def _spread(moved: Array) -> float:
    if len(moved) < 2:
        return 0.0
    sizes = np.linalg.svd(_axes(moved), compute_uv=False)
    return float(sizes[1] / sizes[0])


def _park(moved: Array, seen: Array) -> Array:
    """Return the rotation of X: it turns rotation vectors of B to those of A (Park and Martin, eq. 14)."""
    ours = _axes(moved) * angles(moved[:, :3, :3])[:, None]
    theirs = _axes(seen) * angles(seen[:, :3, :3])[:, None]
    # (MᵀM)^(-1/2) Mᵀ with M = Σ b aᵀ: the nearest rotation, but for a reflection.
    return nearest_rotation(ours.T @ theirs)


_HALF_TURNS: Final = tuple(
    np.diag(signs) for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))
)
"""None, and one about each axis: Tsai's parameters have none for a half turn of X; one of these avoids it."""


def _tsai(moved: Array, seen: Array) -> Array:
    """Return the rotation of X by modified Rodrigues parameters (Tsai and Lenz, eq. 12 to 14)."""
    ours = _axes(moved) * 2.0 * np.sin(angles(moved[:, :3, :3]) / 2.0)[:, None]
    theirs = _axes(seen) * 2.0 * np.sin(angles(seen[:, :3, :3]) / 2.0)[:, None]
    best, rotation = 0.0, np.eye(3)
    for half in _HALF_TURNS:
        turned = theirs @ half.T
        tangents, sizes = _least_squares(
            _skews(ours + turned).reshape(-1, 3), (turned - ours).ravel()
        )
        if sizes[-1] > best:
            best, rotation = float(sizes[-1]), _of_tangents(tangents) @ half
    return rotation


def _of_tangents(tangents: Array) -> Array:
    """Return the rotation (3, 3) of its axis times the tangent of half its angle (3,)."""
    square, skew = float(tangents @ tangents), _skews(tangents[None])[0]
    result: Array = (
        (1.0 - square) * np.eye(3) + 2.0 * np.outer(tangents, tangents) + 2.0 * skew
    ) / (1.0 + square)
    return result


def _skews(vectors: Array) -> Array:
    """Return the matrices (n, 3, 3) that are cross products with vectors (n, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = np.array(((zero, -z, y), (z, zero, -x), (-y, x, zero)))
    return np.moveaxis(rows, 2, 0)


def _translation(moved: Array, seen: Array, rotation: Array) -> Array:
    """Return the translation of X: (R_A - 1) x = R_X b - a."""
    matrix = (moved[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (seen[:, :3, 3] @ rotation.T - moved[:, :3, 3]).ravel()
    return _least_squares(matrix, right)[0]


def _least_squares(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Return the solution, and the singular values of the matrix, the largest first."""
    solution, _, _, sizes = np.linalg.lstsq(matrix, right, rcond=None)
    return np.asarray(solution, dtype=np.float64), np.asarray(sizes, dtype=np.float64)


ROTATIONS: Final[Mapping[Method, Callable[[Array, Array], Array]]] = MappingProxyType(
    {"park": _park, "tsai": _tsai}
)
