"""The geometry of a serial arm as data: its moving joints, from base to tip.

A `Chain` comes from a Denavit-Hartenberg table (`chain_from_dh`) or a URDF (`crtk_drivers.kinematics.urdf`).
Lengths in m, angles in rad, transforms as (4, 4) matrices that act on columns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from crtk_drivers.errors import ConfigError
from crtk_drivers.samples import Array, Vector

__all__ = ["Chain", "ChainJoint", "DHConvention", "DHJoint", "JointKind", "chain_from_dh"]

LARGEST: Final = 1e100
"""Numbers beyond it would overflow when they are put together."""
MAX_JOINTS: Final = 32
"""Most moving joints of one chain."""


class JointKind(StrEnum):
    """How a joint moves. A continuous joint is a revolute one without limits."""

    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True, slots=True, eq=False)
class ChainJoint:
    """One moving joint.

    Attributes:
        placement: of the joint at position 0 in the frame of the joint before it (4, 4).
        axis: of rotation or translation in its own frame (3,); made unit length.
        lower, upper: position limits in rad or m; infinite where there is none.

    Raises:
        ConfigError: no name, no axis, not finite, or an empty range.
        ValueError: no such kind.
    """

    name: str
    kind: JointKind
    placement: Array
    axis: Vector
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        if not self.name:
            raise ConfigError("a joint has no name", remedy="Give each joint a name.")
        what = f"joint {self.name!r}"
        object.__setattr__(self, "kind", JointKind(self.kind))
        axis = _frozen(self.axis, (3,), f"{what}: axis")
        length = math.hypot(*axis.tolist())
        if not 0.0 < length < math.inf:
            raise ConfigError(f"{what}: axis is {axis.tolist()}", remedy="Give it a direction.")
        if not self.lower < self.upper:
            raise ConfigError(
                f"{what}: lower limit {self.lower} is not below upper {self.upper}",
                remedy="Give a range; a joint without limits has lower -inf and upper inf.",
            )
        object.__setattr__(self, "placement", _frozen(self.placement, (4, 4), f"{what}: placement"))
        object.__setattr__(self, "axis", _frozen(axis / length, (3,), what))


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The moving joints from base to tip.

    Attributes:
        joints: in the order of the chain.
        tip: placement of the tip in the frame of the last joint (4, 4).
        names: of the joints in the order of every joint vector; by default that of the chain.

    Raises:
        ConfigError: no joint, too many, or `names` are not exactly those of the joints.
    """

    joints: tuple[ChainJoint, ...]
    tip: Array
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        own = tuple(joint.name for joint in self.joints)
        names = self.names or own
        if not 1 <= len(own) <= MAX_JOINTS:
            raise ConfigError(
                f"the chain has {len(own)} moving joints",
                remedy=f"From 1 to {MAX_JOINTS} are supported: check the base and the tip.",
            )
        if sorted(names) != sorted(own) or len(set(own)) != len(own):
            raise ConfigError(
                f"joint names {', '.join(map(repr, names))} for a chain of "
                f"{', '.join(map(repr, own))}",
                remedy="Name every moving joint between base and tip once, in the order you want.",
            )
        object.__setattr__(self, "tip", _frozen(self.tip, (4, 4), "tip placement"))
        object.__setattr__(self, "names", names)

    @property
    def links_length(self) -> float:
        """Sum of the fixed lengths from the first joint to the tip, in m."""
        placements = [*(joint.placement for joint in self.joints[1:]), self.tip]
        return sum(float(np.linalg.norm(placement[:3, 3])) for placement in placements)

    @property
    def reach(self) -> float:
        """Upper bound of the distance from the first joint to the tip, in m; may be infinite."""
        slides = (j for j in self.joints if j.kind is JointKind.PRISMATIC)
        return self.links_length + sum(max(abs(j.lower), abs(j.upper)) for j in slides)


class DHConvention(StrEnum):
    """What the four numbers of a row mean.

    STANDARD (Denavit and Hartenberg, Paul): Rz(theta) Tz(d) Tx(a) Rx(alpha), a and alpha those of the
    link after the joint. MODIFIED (Craig): Rx(alpha) Tx(a) Rz(theta) Tz(d), those of the link before it.
    """

    STANDARD = "standard"
    MODIFIED = "modified"


@dataclass(frozen=True, slots=True)
class DHJoint:
    """One row of a Denavit-Hartenberg table, with the limits of the joint.

    The joint position is added to `theta` of a revolute joint and to `d` of a prismatic one.
    """

    name: str
    a: float = 0.0
    alpha: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    kind: JointKind = JointKind.REVOLUTE
    lower: float = -math.inf
    upper: float = math.inf


def chain_from_dh(
    rows: Iterable[DHJoint], convention: DHConvention = DHConvention.STANDARD
) -> Chain:
    """Return the chain of a Denavit-Hartenberg table; the last frame of the table is the tip.

    Raises:
        ConfigError: no row, a name twice, a number that is not finite, an empty range.
        ValueError: no such convention, or kind of joint.
    """
    joints = []
    before = np.eye(4)
    for row in rows:
        numbers = (row.a, row.alpha, row.d, row.theta)
        if not all(abs(number) <= LARGEST for number in numbers):
            raise ConfigError(
                f"joint {row.name!r}: a, alpha, d and theta are {numbers}",
                remedy="Give finite numbers, in m and rad.",
            )
        along_z = placed(turn(2, row.theta), (0.0, 0.0, row.d))
        along_x = placed(turn(0, row.alpha), (row.a, 0.0, 0.0))
        if DHConvention(convention) is DHConvention.MODIFIED:
            placement, after = before @ along_x @ along_z, np.eye(4)
        else:  # turning and sliding along z commute with the motion of the joint
            placement, after = before @ along_z, along_x
        axis = np.array((0.0, 0.0, 1.0))
        joints.append(ChainJoint(row.name, row.kind, placement, axis, row.lower, row.upper))
        before = after
    return Chain(tuple(joints), before)


def turn(axis: int, angle: float) -> Array:
    """Return the rotation matrix (3, 3) of `angle` about x, y or z (0, 1, 2)."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[j, j] = rotation[k, k] = math.cos(angle)
    rotation[k, j] = math.sin(angle)
    rotation[j, k] = -rotation[k, j]
    return rotation


def placed(rotation: Array, position: Sequence[float]) -> Array:
    placement = np.eye(4)
    placement[:3, :3] = rotation
    placement[:3, 3] = position
    return placement


def _frozen(values: Array, shape: tuple[int, ...], what: str) -> Array:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigError(f"{what} is {array.tolist()}", remedy=f"Give {shape} finite numbers.")
    array.setflags(write=False)
    return array
