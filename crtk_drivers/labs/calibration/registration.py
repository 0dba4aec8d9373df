"""Where one frame is in another, from points that are known in both.

Least squares by the singular value decomposition (Arun, Huang, Blostein 1987; the reflection as in Umeyama
1991). Errors as Fitzpatrick, West and Maurer tell them ("Predicting error in rigid-body point-based
registration", IEEE TMI 17, 1998): FRE of the points, TRE at any other place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.errors import CalibrationError
from crtk_drivers.geometry.quaternions import quaternion_from_matrix
from crtk_drivers.labs.calibration.stacks import nearest_rotation, points_of, rms
from crtk_drivers.samples import Array, Pose, vector

LEAST: Final = 3
"""Points."""
THINNEST: Final = 0.05
"""Of how far points spread along their longest axis, what they must along the next: else they are a line."""

Points = Sequence[Sequence[float]] | Array
"""(n, 3) in m."""


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Where a model is.

    Attributes:
        pose: of the model's frame in the frame of the measured points.
        fre: m RMS of the distances between measured and registered points.
        residuals: (n,) these distances, in m.
        fle: m RMS, the error of locating a point as far as the residuals tell it: of few points, not far.
        mirrored: the points fit better as mirror images: two are mixed up, or an axis has the wrong sign.
    """

    pose: Pose
    fre: float
    residuals: Array
    fle: float
    mirrored: bool
    _centre: Array
    _axes: Array
    _around: Array
    """(3,) RMS distances of the points from their principal axes."""

    def tre(self, place: Sequence[float] | Array) -> float:
        """Return the error to be expected, in m RMS, at a place (3,) of the model, in m."""
        away = self._axes @ (np.asarray(place, dtype=np.float64) - self._centre)
        from_axes = np.sum(np.square(away)) - np.square(away)
        share = np.sum(from_axes / np.square(self._around)) / 3.0
        return float(self.fle * np.sqrt((1.0 + share) / len(self.residuals)))


def register(model: Points, measured: Points, worst: float | None = None) -> Registration:
    """Return where a model is whose points were measured, in the same order.

    Args:
        model: points in the frame of the model.
        measured: the same points in another frame.
        worst: FRE in m beyond which they are refused; None: none is.

    Raises:
        CalibrationError: too few points, none that are, on one line, or further apart than `worst`.
    """
    ours, theirs = points_of(model, "points of the model"), points_of(measured, "measured points")
    if len(ours) != len(theirs) or len(ours) < LEAST:
        raise CalibrationError(
            f"{len(theirs)} measured points for {len(ours)} of the model",
            remedy=f"Give each point in both frames, and at least {LEAST}.",
        )
    centre, there = ours.mean(axis=0), theirs.mean(axis=0)
    axes = _axes_of(ours - centre, "points of the model")
    _axes_of(theirs - there, "measured points")
    crossed = (theirs - there).T @ (ours - centre)
    rotation = nearest_rotation(crossed)
    position = there - rotation @ centre
    residuals = np.linalg.norm(ours @ rotation.T + position - theirs, axis=1)
    fre = rms(residuals)
    mirrored = _is_mirrored(crossed)
    if worst is not None and not fre <= worst:
        hint = " They fit as mirror images: is an axis turned round?" if mirrored else ""
        raise CalibrationError(
            f"FRE {1e3 * fre:.2f} mm, {1e3 * residuals.max():.2f} mm at point "
            f"{int(residuals.argmax()) + 1}.{hint}",
            remedy=f"Measure that point again, or check the order; {1e3 * worst:g} mm are allowed.",
        )
    count = len(ours)
    fle = fre * np.sqrt(count / (count - 2.0))
    along = np.square((ours - centre) @ axes.T).mean(axis=0)
    around = np.sqrt(along.sum() - along)
    pose = Pose(vector(position), quaternion_from_matrix(rotation))
    return Registration(pose, fre, residuals, fle, mirrored, centre, axes, around)


def _axes_of(points: Array, what: str) -> Array:
    """Return the principal axes (3, 3) of centred points, the longest first."""
    _, sizes, axes = np.linalg.svd(points, full_matrices=True)
    if not sizes[1] > THINNEST * sizes[0]:
        raise CalibrationError(
            f"the {what} are on one line, or in one place",
            remedy="Add one that is off that line: about a line nothing says how it is turned.",
        )
    result: Array = axes
    return result


def _is_mirrored(crossed: Array) -> bool:
    """Whether a reflection would fit better; of points in a plane both fit alike."""
    sizes = np.linalg.svd(crossed, compute_uv=False)
    return bool(np.linalg.det(crossed) < 0.0 and sizes[2] > 1e-3 * sizes[0])
