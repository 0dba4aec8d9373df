"""Where a tool was that somebody else moves, as a simulated arm does: poses with their times. Pure."""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Sequence
from typing import Final

from crtk_sim_backends.ndi.motion import Place

KEPT: Final = 256
"""Poses that are kept: seconds of them, at what an arm tells."""

FAR: Final = 10.0
"""mm that a loose marker goes before it sits otherwise."""
TURNED: Final = math.cos(0.05)
"""Of half the angle (rad) that it turns before that."""
ARM: Final = 100.0
"""mm: size of a marker, by which a play in mm is one in rad."""


class Track:
    """The newest poses of one tool."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, Place]] = deque(maxlen=KEPT)

    def put(self, ns: int, at: Place) -> None:
        """Take where it was at a time, in ns since the epoch. What is not newer than the rest is dropped."""
        if not self._poses or ns > self._poses[-1][0]:
            self._poses.append((ns, at))

    def at(self, ns: int) -> Place | None:
        """Return where it was: straight between two poses, and the newest after it; None before the first."""
        later: tuple[int, Place] | None = None
        for when, at in reversed(self._poses):
            if when <= ns:
                return (
                    at if later is None else _between(at, later[1], (ns - when) / (later[0] - when))
                )
            later = when, at
        return None


def _between(first: Place, second: Place, share: float) -> Place:
    here = sum(a * b for a, b in zip(first[3:7], second[3:7], strict=True)) >= 0.0
    x, y, z = (a + share * (b - a) for a, b in zip(first[:3], second[:3], strict=True))
    turned = [
        a + share * ((b if here else -b) - a) for a, b in zip(first[3:7], second[3:7], strict=True)
    ]
    return Place(x, y, z, *_unit(turned), second.error)


def _unit(quaternion: Sequence[float]) -> tuple[float, float, float, float]:
    size = math.hypot(*quaternion)
    q0, qx, qy, qz = (part / size for part in quaternion)
    return q0, qx, qy, qz


class Play:
    """How a marker sits that is not tight: otherwise after each motion.

    Args:
        play: standard deviation of each coordinate, in mm; of each angle the same at `ARM`.
        name: of the marker, by which they differ.
    """

    def __init__(self, play: float, name: str) -> None:
        self._play = play
        self._random = random.Random(name)
        self._sat: Place | None = None
        self._off: Sequence[float] = (0.0,) * 6

    def at(self, at: Place) -> Place:
        """Return where it is on what carries it to `at`."""
        if not self._play:
            return at
        if self._sat is None or _has_moved(self._sat, at):
            self._sat = at
            self._off = [self._random.gauss(0.0, self._play) for _ in range(6)]
        x, y, z, a, b, c = self._off
        a, b, c = (0.5 * part / ARM for part in (a, b, c))
        q0, qx, qy, qz = at[3:7]
        turned = (
            q0 - a * qx - b * qy - c * qz,
            qx + a * q0 + b * qz - c * qy,
            qy + b * q0 + c * qx - a * qz,
            qz + c * q0 + a * qy - b * qx,
        )
        return Place(at.x + x, at.y + y, at.z + z, *_unit(turned), at.error)


def _has_moved(first: Place, second: Place) -> bool:
    alike = abs(sum(a * b for a, b in zip(first[3:7], second[3:7], strict=True)))
    return math.dist(first[:3], second[:3]) > FAR or alike < TURNED
