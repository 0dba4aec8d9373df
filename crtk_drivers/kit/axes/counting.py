"""What counts of axes mean for the joints that they are, and what joints can do. No I/O."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from crtk_drivers.config import AxisJoint
from crtk_drivers.samples import JointState, Vector, vector

__all__ = ["Counting", "can_have_gone", "is_astray"]

FASTER: Final = 10.0
"""Velocities of a joint, as its limit: faster than that nothing moves."""
SLACK: Final = 0.01
"""Seconds of that which are always allowed."""
COUNTER: Final = float(2**32)
"""Counts after which positions are the same again: controllers and drives tell them with 32 bits."""
FAR: Final = 10.0
"""Widths of its range outside of which no joint stands."""


class Counting:
    """Counts of n axes as joints, and the reverse.

    Args:
        joints: by name, in the order of joint vectors.
        units: rad (m) of one count of each, without its sign.
        efforts: N·m (N) of each for one unit of what its controller tells; None: not known.
    """

    def __init__(
        self,
        joints: Mapping[str, AxisJoint],
        units: Sequence[float],
        efforts: Sequence[float | None],
    ) -> None:
        self.names = tuple(joints)
        signs = np.array([joint.sign for joint in joints.values()])
        self.lower = np.array([joint.lower for joint in joints.values()])
        self.upper = np.array([joint.upper for joint in joints.values()])
        self._scale = signs * np.array(units)
        self._offset = np.array([joint.offset for joint in joints.values()])
        known = [effort for effort in efforts if effort is not None]
        self._effort = signs * np.array(known) if len(known) == len(signs) else None

    def positions(self, counts: ArrayLike) -> Vector:
        """Return where joints are, (n,) in rad (m)."""
        return vector(np.asarray(counts) * self._scale + self._offset)

    def astray(self, counts: ArrayLike) -> dict[int, float]:
        """Return the joints that cannot stand where axes tell: places, and positions in rad (m)."""
        ranges = zip(self.lower.tolist(), self.upper.tolist(), self._scale.tolist(), strict=True)
        told = zip(self.positions(counts).tolist(), ranges, strict=True)
        return {
            place: position
            for place, (position, its) in enumerate(told)
            if is_astray(position, *its)
        }

    def counts(self, positions: Vector) -> list[float]:
        """Return where axes are with joints at positions (n,) in rad (m); not rounded."""
        found: list[float] = ((positions - self._offset) / self._scale).tolist()
        return found

    def state(self, counts: ArrayLike, rates: ArrayLike, efforts: ArrayLike) -> JointState:
        """Return what joints do.

        Args:
            counts: (n,) where axes are.
            rates: (n,) counts/s.
            efforts: (n,) in the controller's unit; told only if it is known of all what they mean.
        """
        told = [] if self._effort is None else np.asarray(efforts) * self._effort
        return JointState(
            self.positions(counts),
            vector(np.asarray(rates) * self._scale),
            vector(told),
            name=self.names,
        )


def is_astray(position: float, lower: float, upper: float, count: float) -> bool:
    """Whether a joint cannot stand where its axis tells.

    It is too far from its range, or the counter of the axis has gone over its end: it would be nearer to its
    range if it had not. Setpoints towards the range would drive such a joint away from it.

    Args:
        position: of the joint, in rad (m), as it is told.
        lower, upper: its range.
        count: rad (m) of one count.
    """

    def outside(place: float) -> float:
        return max(lower - place, place - upper, 0.0)

    told, circle = outside(position), COUNTER * abs(count)
    is_near = told <= FAR * (upper - lower)  # not of NaN
    return not is_near or min(outside(position + circle), outside(position - circle)) < told


def can_have_gone(way: float, joint: AxisJoint, seconds: float) -> bool:
    """Whether a joint can have gone that way, in rad (m), between two positions that were told."""
    return abs(way) <= FASTER * joint.velocity * (seconds + SLACK)
