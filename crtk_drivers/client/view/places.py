"""Where devices stand beside each other: by /tf_static where it tells, else in a row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.kinematics.chain import placed
from crtk_drivers.samples import Array, vector

__all__ = ["TF_STATIC", "Frames", "in_a_row"]

TF_STATIC: Final = "/tf_static"
DEEPEST: Final = 64
"""Frames from one to its root, at most: a circle has no end."""
GAP: Final = 0.35
"""m between two devices in a row, beside what they reach."""


class Frames:
    """The tree of fixed frames, as messages on /tf_static tell it."""

    def __init__(self) -> None:
        self._above: dict[str, tuple[str, Array]] = {}

    def take(self, message: Any) -> None:
        """Keep what a tf2_msgs/TFMessage says; a transform that is none is passed over."""
        for each in message.transforms:
            t, r = each.transform.translation, each.transform.rotation
            numbers = vector([t.x, t.y, t.z, r.x, r.y, r.z, r.w])
            if not np.all(np.isfinite(numbers)) or abs(np.linalg.norm(numbers[3:]) - 1.0) > 1e-3:
                continue
            at = placed(matrix_from_quaternion(numbers[3:]), numbers[:3].tolist())
            self._above[each.child_frame_id.lstrip("/")] = (each.header.frame_id.lstrip("/"), at)

    def root(self, frame: str) -> tuple[str, Array]:
        """Return the root above a frame, and where the frame is in it (4, 4)."""
        found = np.eye(4)
        for _ in range(DEEPEST):
            if frame not in self._above:
                break
            frame, at = self._above[frame]
            found = at @ found
        return frame, found

    def places(self, frames: Mapping[str, str]) -> dict[str, Array]:
        """Return where those devices stand that have the most common root, by namespace.

        Args:
            frames: the base frame of each device, by namespace.
        """
        roots = {name: self.root(frame) for name, frame in frames.items() if frame in self._above}
        names = [root for root, _ in roots.values()]
        common = max(names, key=names.count, default="")
        return {name: at for name, (root, at) in roots.items() if root == common}


def in_a_row(reaches: Sequence[float], behind: float = 0.0) -> list[Array]:
    """Return places (4, 4) side by side along y, for devices that reach so far (m), from `behind` on."""
    found, at = [], behind
    for reach in reaches:
        at += 0.5 * reach + GAP
        found.append(placed(np.eye(3), (0.0, at, 0.0)))
        at += 0.5 * reach
    return found
