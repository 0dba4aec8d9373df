"""Where the tools are: on paths through the volume, with noise. A function of time alone."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import Final, NamedTuple

from crtk_sim_backends.ndi.families import Family

RADIUS: Final = 60.0
"""mm of a circle."""
TURN: Final = 4.0
"""Seconds for it."""
APART: Final = 40.0
"""mm between two tools."""


class Place(NamedTuple):
    """A pose in mm, and the quaternion with its scalar first; error: what the tracker says of it."""

    x: float
    y: float
    z: float
    q0: float
    qx: float
    qy: float
    qz: float
    error: float


class Motion(NamedTuple):
    """How far a path goes: radius of its circle, and amplitude along z, in mm."""

    radius: float
    depth: float


MOTIONS: Final[Mapping[str, Motion]] = {
    "circle": Motion(RADIUS, 0.0),
    "still": Motion(0.0, 0.0),
    "leave": Motion(0.0, 2000.0),
}
"""By their names: around the middle of the volume, at rest there, out of the volume and back."""


def place(family: Family, motion: Motion, tool: int, frame: int, noise: float) -> Place:
    """Return where a tool is in a frame.

    Args:
        family: whose volume and rate count.
        motion: its path.
        tool: its number.
        frame: number of it.
        noise: RMS of each coordinate, in mm.
    """
    angle = 2.0 * math.pi * frame / family.rate / TURN
    chance = random.Random(frame * 64 + tool)
    shake = [chance.gauss(0.0, noise) if noise else 0.0 for _ in range(3)]
    depth = motion.depth * (1.0 - math.cos(angle)) / 2.0
    half = (angle + tool) / 2.0
    return Place(
        motion.radius * math.cos(angle) + APART * tool + shake[0],
        motion.radius * math.sin(angle) + shake[1],
        family.middle - depth + shake[2],
        math.cos(half),
        0.0,
        0.0,
        math.sin(half),
        noise + 0.1,
    )


def is_inside(family: Family, at: Place) -> bool:
    """Whether it is in the volume, which opens away from the tracker."""
    if not family.near >= at.z >= family.far:
        return False
    half = family.half * at.z / family.far
    return abs(at.x) <= half and abs(at.y) <= half
