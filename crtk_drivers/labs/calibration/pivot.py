"""The tip of a pointer, from poses while it turns about its tip.

The tip rests in one place: ``R_i · tip + p_i = place`` for each pose, which is linear in both (Yaniv, "Which
pivot calibration?", SPIE Medical Imaging 2015, the algebraic one-step method).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.errors import CalibrationError
from crtk_drivers.labs.calibration.stacks import angles, nearest_rotation, rms, stacked
from crtk_drivers.samples import Array, Pose, Vector, vector

LEAST: Final = 20
"""Poses."""
LEAST_SPREAD: Final = 0.06
"""What turns must make of 1, see `Pivot.spread`: about 7° to each side, about each axis but one."""
WORST: Final = 2e-3
"""m RMS: a pointer of which a tracker thinks well has a tenth of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Pivot:
    """A pointer.

    Attributes:
        tip: (3,) in the frame of the pointer, in m.
        place: (3,) where it rested, in the frame of the poses, in m.
        residual: m RMS over the poses of how far the tip is from that place.
        residuals: (n,) of each pose, in m.
        deviation: (3,) standard deviation of the tip in m, as far as residuals tell it.
        spread: from 0 (all poses turn about one axis, or not at all) to 1: how well the tip is told from the
            place; errors of the tip are those of the poses divided by this and the root of their number.
        widest: rad between the mean orientation and the farthest.
    """

    tip: Vector
    place: Vector
    residual: float
    residuals: Array
    deviation: Vector
    spread: float
    widest: float


def pivot(poses: Sequence[Pose], worst: float = WORST) -> Pivot:
    """Return the tip of a pointer that turned about it.

    Args:
        poses: of the pointer, all in one frame.
        worst: residual in m beyond which the tip cannot have rested.

    Raises:
        CalibrationError: too few poses, none that are, all alike or about one axis, or the tip slipped.
    """
    transforms = stacked(poses, LEAST, "poses")
    count = len(transforms)
    rotations, positions = transforms[:, :3, :3], transforms[:, :3, 3]
    rows = np.concatenate((rotations, np.broadcast_to(-np.eye(3), (count, 3, 3))), axis=2)
    matrix = rows.reshape(3 * count, 6)
    spread = float(np.linalg.svd(matrix, compute_uv=False)[-1] / np.sqrt(count))
    widest = float(angles(nearest_rotation(rotations.mean(axis=0)).T @ rotations).max())
    if spread < LEAST_SPREAD:
        raise CalibrationError(
            f"the pointer hardly turned, or about one axis only (spread {spread:.3f} of at least "
            f"{LEAST_SPREAD:g}; {np.degrees(widest):.0f}° at the most)",
            remedy="Tilt it by 20° or more to all sides, with its tip at rest.",
        )
    solution = np.linalg.lstsq(matrix, -positions.ravel(), rcond=None)[0]
    tip, place = solution[:3], solution[3:]
    off = rotations @ tip + positions - place
    residuals = np.linalg.norm(off, axis=1)
    residual = rms(residuals)
    if not residual <= worst:
        raise CalibrationError(
            f"the tip did not rest: residual {1e3 * residual:.2f} mm RMS, {1e3 * residuals.max():.2f} mm "
            f"at pose {int(residuals.argmax()) + 1}",
            remedy=f"Let it rest in a small hollow, and try again; {1e3 * worst:g} mm are allowed.",
        )
    variance = float(np.square(off).sum()) / (3 * count - 6)
    covariance = variance * np.linalg.inv(matrix.T @ matrix)
    return Pivot(
        vector(tip),
        vector(place),
        residual,
        residuals,
        vector(np.sqrt(np.diag(covariance)[:3])),
        spread,
        widest,
    )
