"""Where the tools are that nobody moves: on paths through the volume; and noise. Functions of time alone."""

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


ERROR: Final = 0.1
"""mm that a tracker tells as its error, beside its noise."""


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
    """How far a path goes: radius of its circle and amplitude along z, in mm; tilt about its tip, in rad."""

    radius: float
    depth: float
    tilt: float = 0.0


MOTIONS: Final[Mapping[str, Motion]] = {
    "circle": Motion(RADIUS, 0.0),
    "still": Motion(0.0, 0.0),
    "leave": Motion(0.0, 2000.0),
    "pivot": Motion(0.0, 0.0, 0.5),
}
"""By their names: around the middle of the volume, at rest there, out of the volume and back, about a tip."""

TIP: Final = (18.0, -3.0, -157.0)
"""mm: where the tip of a tool is that pivots, in its frame."""


def place(family: Family, motion: Motion, tool: int, frame: int) -> Place:
    """Return where a tool is in a frame.

    Args:
        family: whose volume and rate count.
        motion: its path.
        tool: its number.
        frame: number of it.
    """
    angle = 2.0 * math.pi * frame / family.rate / TURN
    depth = motion.depth * (1.0 - math.cos(angle)) / 2.0
    if motion.tilt:
        return _about_its_tip(motion.tilt, angle, (APART * tool, 0.0, family.middle))
    turned = angle if any(motion) else 0.0
    half = (turned + tool) / 2.0
    return Place(
        motion.radius * math.cos(angle) + APART * tool,
        motion.radius * math.sin(angle),
        family.middle - depth,
        math.cos(half),
        0.0,
        0.0,
        math.sin(half),
        ERROR,
    )


def shaken(at: Place, tool: int, frame: int, noise: float) -> Place:
    """Return where a tool is seen that is at a place.

    Args:
        at: where it is.
        tool, frame: their numbers.
        noise: RMS of each coordinate, in mm.
    """
    if not noise:
        return at
    chance = random.Random(frame * 64 + tool)
    x, y, z = (coordinate + chance.gauss(0.0, noise) for coordinate in at[:3])
    return at._replace(x=x, y=y, z=z, error=at.error + noise)


def _about_its_tip(tilt: float, angle: float, middle: tuple[float, float, float]) -> Place:
    """Return where a tool is whose tip rests in `middle` while it tilts about x and y, not in step."""
    a, b = tilt * math.sin(angle) / 2.0, tilt * math.sin(0.7 * angle) / 2.0
    q0, x, y = math.cos(a) * math.cos(b), math.sin(a) * math.cos(b), math.cos(a) * math.sin(b)
    z = math.sin(a) * math.sin(b)
    i, j, k = TIP
    u, v, w = 2.0 * (y * k - z * j), 2.0 * (z * i - x * k), 2.0 * (x * j - y * i)
    turned = (
        i + q0 * u + y * w - z * v,
        j + q0 * v + z * u - x * w,
        k + q0 * w + x * v - y * u,
    )
    px, py, pz = (at - part for at, part in zip(middle, turned, strict=True))
    return Place(px, py, pz, q0, x, y, z, ERROR)


def is_inside(family: Family, at: Place) -> bool:
    """Whether it is in the volume, which opens away from the tracker."""
    if not family.near >= at.z >= family.far:
        return False
    half = family.half * at.z / family.far
    return abs(at.x) <= half and abs(at.y) <= half
