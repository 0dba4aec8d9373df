"""Postures around where an arm is, of which a test takes those that differ most."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.samples import Array, Vector

CANDIDATES: Final = 60
"""Postures of which some are taken."""

WRIST: Final = 3
"""Joints that move the tool least: the last ones that turn."""


def wrist(arm: Bed) -> NDArray[np.intp]:
    """Return the numbers of the last joints that turn."""
    return np.flatnonzero(arm.slides < 0.5)[-WRIST:]


def around(arm: Bed, far: Vector) -> Array:
    """Return postures (k, n) around where it is, within the limits of the run; the same ones in each run.

    Args:
        arm: whose they are.
        far: (n,) how far a joint goes at most, in rad (m); 0 for one that stays.
    """
    home = arm.setpoint
    moved = np.flatnonzero(far)
    down, up = (np.clip(way, 0.0, far)[moved] for way in arm.room())
    found = np.tile(home, (CANDIDATES, 1))
    found[:, moved] += np.random.default_rng(1).uniform(-down, up, (CANDIDATES, moved.size))
    return found


def least_alike(likeness: Array, count: int) -> list[int]:
    """Return the numbers of those that differ most, each from all before it; the first one is taken.

    Args:
        likeness: (k, k) of any two, at most 1.
        count: how many are wanted; all of them where there are fewer.
    """
    taken = list(range(min(1, len(likeness))))
    while len(taken) < min(count, len(likeness)):
        away = 1.0 - likeness[:, taken].max(axis=1)
        away[taken] = -1.0
        taken.append(int(np.argmax(away)))
    return taken
