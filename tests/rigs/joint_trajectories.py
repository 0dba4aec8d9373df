"""Trajectories of joints for tests, from rows of numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from crtk_drivers.samples import Array, JointTrajectory, Tolerance, vector


def trajectory(
    names: Sequence[str],
    times: Sequence[float],
    positions: Any,
    velocities: Any = None,
    accelerations: Any = None,
    **changes: Any,
) -> JointTrajectory:
    """Points at `times`; None where nothing, or for a point nothing, is given."""
    at = np.asarray(positions, dtype=float)
    return JointTrajectory(
        tuple(names),
        vector(times),
        at,
        _rows(velocities, at),
        _rows(accelerations, at),
        **changes,
    )


def _rows(values: Any, like: Array) -> Array:
    rows = np.full(like.shape, np.nan)
    for row, given in enumerate(values or ()):
        if given is not None:
            rows[row] = given
    return rows


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0) -> Tolerance:
    return Tolerance(name, position, velocity)
