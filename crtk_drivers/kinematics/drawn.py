"""A chain as a page draws it: each joint turns about z of its frame, or slides along it. Lengths in m."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crtk_drivers.kinematics.chain import Chain, JointKind
from crtk_drivers.kinematics.joint_axes import frame_on_axis
from crtk_drivers.samples import Array

__all__ = ["DrawnChain", "drawn", "numbers_of"]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnChain:
    """Joints from base to tip.

    Attributes:
        names: of the joints.
        joints: transforms (4, 4), each from the link before it, or the base, at position 0.
        slides: whether each slides.
        tip: from the last link to the tip (4, 4).
    """

    names: tuple[str, ...]
    joints: tuple[Array, ...]
    slides: tuple[bool, ...]
    tip: Array

    @property
    def reach(self) -> float:
        """Length of all links from the second joint on, in m."""
        return sum(float(np.linalg.norm(each[:3, 3])) for each in (*self.joints[1:], self.tip))


def drawn(chain: Chain) -> DrawnChain:
    """Return a chain with frames on the axes of its joints, where the axis before comes nearest."""
    joints: list[Array] = []
    before, at = np.eye(4), np.eye(4)
    for joint in chain.joints:
        at = at @ joint.placement
        frame = frame_on_axis(before, at[:3, :3] @ joint.axis, at[:3, 3])
        joints.append(np.linalg.inv(before) @ frame)
        before = frame
    return DrawnChain(
        tuple(joint.name for joint in chain.joints),
        tuple(joints),
        tuple(joint.kind is JointKind.PRISMATIC for joint in chain.joints),
        np.linalg.inv(before) @ at @ chain.tip,
    )


def numbers_of(transform: Array) -> list[float]:
    """Return the three rows of a transform (4, 4), 12 numbers."""
    numbers: list[float] = transform[:3].ravel().tolist()
    return numbers
