"""Calibration: how near it comes to the truth, and what it costs, by number and spread of the poses.

Synthetic poses of a tracker with 0.25 mm RMS in each coordinate, as a Polaris has, and 0.05° for hand-eye.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from bench.report import options, show
from crtk_drivers.geometry.conversions import as_pose, to_matrix
from crtk_drivers.geometry.quaternions import quaternion_from_rotvec
from crtk_drivers.labs.calibration import hand_eye, pivot, register
from crtk_drivers.labs.calibration.hand_eye import ROTATIONS, Method
from crtk_drivers.samples import Array, Pose, vector

NOISE = 0.25e-3
"""m RMS of each coordinate."""
TURN = np.radians(0.05)
"""rad RMS about each axis."""
TIP = np.array((0.018, -0.003, -0.157))
MODEL = np.array([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1), (0.1, 0.1, 0.1)], dtype=float)
TARGET = (0.05, 0.05, 0.2)


def pose(position: Array, rotvec: Array) -> Pose:
    """Return a pose of a position and a rotation vector."""
    return Pose(vector(position), quaternion_from_rotvec(vector(rotvec)))


def seen(true: Array, noise: np.random.Generator) -> Pose:
    """Return a transform as a tracker sees it."""
    found = true.copy()
    shake = to_matrix(pose(np.zeros(3), TURN * noise.standard_normal(3)))
    found[:3, :3] = shake[:3, :3] @ found[:3, :3]
    found[:3, 3] += NOISE * noise.standard_normal(3)
    return as_pose(found)


def pivoting(count: int, tilt: float, noise: np.random.Generator) -> list[Pose]:
    """Return poses of a pointer that is tilted by up to `tilt` rad to each side, and spun."""
    found = []
    for _ in range(count):
        turned = to_matrix(pose(np.zeros(3), noise.uniform(-tilt, tilt, 3)))
        position = -turned[:3, :3] @ TIP + NOISE * noise.standard_normal(3)
        found.append(Pose(vector(position), as_pose(turned).orientation))
    return found


def tip_error(count: int, tilt: float, trials: int) -> tuple[float, float]:
    """Return how far tips are from the truth, and how far they say that they are; m RMS."""
    noise = np.random.default_rng(1)
    found = [pivot(pivoting(count, tilt, noise)) for _ in range(trials)]
    off = np.sqrt(np.mean([np.sum(np.square(each.tip - TIP)) for each in found]))
    told = np.sqrt(np.mean([np.sum(np.square(each.deviation)) for each in found]))
    return float(off), float(told)


def paired(count: int, noise: np.random.Generator) -> tuple[list[Pose], list[Pose], Array, Array]:
    """Return poses of an arm and its marker, and the truth: marker in flange, tracker in base."""
    marker = to_matrix(pose(np.array((0.02, -0.05, 0.11)), np.array((0.5, 1.2, -0.7))))
    tracker = to_matrix(pose(np.array((1.4, 0.3, 0.8)), np.array((-1.0, 2.0, 0.4))))
    arm = [pose(noise.uniform(-0.3, 0.3, 3), noise.uniform(-0.7, 0.7, 3)) for _ in range(count)]
    markers = [seen(np.linalg.inv(tracker) @ to_matrix(each) @ marker, noise) for each in arm]
    return arm, markers, marker, tracker


def hand_eye_error(count: int, method: Method, trials: int) -> tuple[float, float, float]:
    """Return how far markers (m, °) and trackers (m) are from the truth, RMS."""
    noise, off = np.random.default_rng(2), []
    for _ in range(trials):
        arm, markers, marker, tracker = paired(count, noise)
        found = hand_eye(arm, markers, method)
        x, y = to_matrix(found.marker), to_matrix(found.tracker)
        cosine = (np.trace(x[:3, :3].T @ marker[:3, :3]) - 1.0) / 2.0
        off.append(
            (
                np.linalg.norm(x[:3, 3] - marker[:3, 3]),
                np.degrees(np.arccos(min(1.0, cosine))),
                np.linalg.norm(y[:3, 3] - tracker[:3, 3]),
            )
        )
    place, turned, far = np.sqrt(np.mean(np.square(off), axis=0))
    return float(place), float(turned), float(far)


def register_error(count: int, trials: int) -> tuple[float, float]:
    """Return TRE at `TARGET` as it is, and as it is told; m RMS."""
    noise, off = np.random.default_rng(3), []
    model = MODEL[:count]
    for _ in range(trials):
        found = register(model, model + NOISE * noise.standard_normal(model.shape))
        matrix = to_matrix(found.pose)
        there = matrix[:3, :3] @ TARGET + matrix[:3, 3]
        off.append((np.linalg.norm(there - TARGET), found.tre(TARGET)))
    true, told = np.sqrt(np.mean(np.square(off), axis=0))
    return float(true), float(told)


def milliseconds(call: Callable[[], object], calls: int = 20) -> str:
    """Return what one call takes."""
    begin = time.perf_counter()
    for _ in range(calls):
        call()
    return f"{(time.perf_counter() - begin) / calls * 1e3:.1f}"


def mm(*values: float) -> list[str]:
    """Return lengths in mm, as text."""
    return [f"{value * 1e3:.3f}" for value in values]


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", trials=(200, "of each figure"))
    trials = given.trials
    rows = []
    for count in (20, 100, 500):
        for degrees in (10, 20, 40):
            off, told = tip_error(count, np.radians(degrees), trials)
            poses = pivoting(count, np.radians(degrees), np.random.default_rng(1))
            cost = milliseconds(lambda poses=poses: pivot(poses))  # type: ignore[misc]
            rows.append((f"{count} poses, {degrees}°", *mm(off, told), cost))
    show("tip of a pointer, mm RMS", ("", "off", "told", "ms"), rows)
    rows = []
    for count in (3, 4, 5):
        cost = milliseconds(lambda count=count: register(MODEL[:count], MODEL[:count]))  # type: ignore[misc]
        rows.append((f"{count} points", *mm(*register_error(count, trials)), cost))
    show("TRE of a registration, mm RMS", ("", "off", "told", "ms"), rows)
    rows = []
    for count in (6, 15, 40):
        for method in ROTATIONS:
            place, turned, far = hand_eye_error(count, method, trials)
            arm, markers, _, _ = paired(count, np.random.default_rng(2))
            cost = milliseconds(lambda a=arm, b=markers, c=method: hand_eye(a, b, c))  # type: ignore[misc]
            name = f"{count} pairs, {method}"
            rows.append((name, *mm(place), f"{turned:.3f}", *mm(far), cost))
    show("hand-eye, RMS", ("", "marker, mm", "marker, °", "tracker, mm", "ms"), rows)


if __name__ == "__main__":
    main()
