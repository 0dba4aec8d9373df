"""Synthetic measurements of a tracker: true places, what is seen of them, and noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crtk_drivers.geometry.frames import inverse_pose, product
from crtk_drivers.geometry.quaternions import (
    quaternion_from_rotvec,
    quaternion_product,
    rotated,
    unit,
)
from crtk_drivers.samples import Pose, vector


def pose(position: Sequence[float], rotvec: Sequence[float]) -> Pose:
    return Pose(vector(position), quaternion_from_rotvec(vector(rotvec)))


def noisy(true: Pose, noise: np.random.Generator, metres: float, rad: float) -> Pose:
    turned = quaternion_from_rotvec(vector(rad * noise.standard_normal(3)))
    position = true.position + metres * noise.standard_normal(3)
    return Pose(vector(position), unit(quaternion_product(turned, true.orientation)))


def about_its_tip(
    tip: Sequence[float],
    place: Sequence[float],
    count: int,
    widest: float,
    noise: np.random.Generator,
    metres: float = 0.0,
) -> list[Pose]:
    """Poses of a pointer whose tip rests in a place while it is tilted by up to `widest` rad, and spun."""
    found = []
    for _ in range(count):
        about = noise.uniform(-1.0, 1.0, 3) * (widest, widest, widest)
        turned = quaternion_from_rotvec(vector(about))
        position = np.array(place) - rotated(turned, *tip)
        found.append(noisy(Pose(vector(position), turned), noise, metres, 0.0))
    return found


def arm_and_marker(
    marker: Pose,
    tracker: Pose,
    count: int,
    noise: np.random.Generator,
    metres: float = 0.0,
    rad: float = 0.0,
) -> tuple[list[Pose], list[Pose]]:
    """Poses of a flange in its base, and of a marker on it in a tracker that stands at `tracker`."""
    arm = [
        pose(noise.uniform(-0.5, 0.5, 3).tolist(), noise.uniform(-1.0, 1.0, 3).tolist())
        for _ in range(count)
    ]
    seen = [
        noisy(product(inverse_pose(tracker), product(each, marker)), noise, metres, rad)
        for each in arm
    ]
    return arm, seen
