"""The factory calibration of an arm: lengths and angles of its own links, beside the model's.

Denavit-Hartenberg, standard form: each joint is Rz(q + θ) Tz(d) Tx(a) Rx(α). Where the axes of two
joints are nearly parallel (2, 3 and 4), calibrated offsets along them may be metres that cancel each other:
compare what they do to the tool, not the numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from math import cos, sin
from random import Random
from typing import Final

import numpy as np
from pydantic import Field
from typing_extensions import override

from crtk_driver_ur.frames import IDENTITY, Transform, compose
from crtk_driver_ur.kinematics import ArmKinematics, IkFailure, InverseKinematicsError
from crtk_driver_ur.models import RobotModel, Vector6
from crtk_drivers.config import Settings
from crtk_drivers.samples import Array, Vector

__all__ = ["NOMINAL", "CalibratedKinematics", "Calibration", "displacements"]

EXACT: Final = 1e-10
"""m and rad by which a solution may miss its pose."""
ITERATIONS: Final = 8
NEAR: Final = 0.2
"""rad by which joint angles may differ from those that the correction begins with."""
FOLLOWED: Final = 0.05
"""rad within which a solution is taken for the nearest to the reference, as in a stream."""
_DAMPING: Final = 1e-12 * np.eye(6)
NOMINAL: Final = 1e-6
"""m between flange and model below which an arm has the model's own lengths."""
POSTURES: Final = 200
"""Over which the calibration is compared with the model."""

Checksum = tuple[int, int, int, int, int, int]


class Calibration(Settings):
    """As the controller has it; made by ``crtk-driver ur info --output``."""

    checksum: Checksum = Field(description="By which the controller tells calibrations apart.")
    theta: Vector6 = Field(description="Offsets of the joint angles, in rad.")
    a: Vector6 = Field(description="Lengths along x, in m.")
    d: Vector6 = Field(description="Offsets along z, in m.")
    alpha: Vector6 = Field(description="Twists about x, in rad.")

    def frames(self, q: Sequence[float]) -> Iterator[Transform]:
        """Yield the frame behind each joint for joint angles `q` (6, rad); the last is the flange."""
        frame = IDENTITY
        for angle, theta, a, d, alpha in zip(
            q, self.theta, self.a, self.d, self.alpha, strict=True
        ):
            c, s, ca, sa = cos(angle + theta), sin(angle + theta), cos(alpha), sin(alpha)
            frame = compose(
                frame,
                Transform(c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, sa, ca, a * c, a * s, d),
            )
            yield frame

    def flange(self, q: Sequence[float]) -> Transform:
        """Return the pose of the flange in the base frame for joint angles `q` (6, rad)."""
        *_, flange = self.frames(q)
        return flange


class CalibratedKinematics(ArmKinematics):
    """As `ArmKinematics`, with the arm's own calibration instead of the model's numbers.

    The inverse begins with the reference; where that is not near, with the closed form, and corrects it:
    the two differ by millimetres. Where the elbow is nearly straight the closed form may have no solution
    near the reference though the arm has one.

    Args:
        model: the arm.
        calibration: its own.
        tool: flange to tool centre point (TCP).
    """

    def __init__(
        self, model: RobotModel, calibration: Calibration, tool: Transform = IDENTITY
    ) -> None:
        super().__init__(model, tool)
        self._calibration = calibration
        self._tool_or_none = None if tool == IDENTITY else tool

    @override
    def place(self, q: Sequence[float]) -> Transform:
        return self._tool_behind(self._calibration.flange(q))

    @override
    def solve(self, pose: Transform, reference: Sequence[float]) -> Vector6:
        with suppress(InverseKinematicsError):
            found = self._corrected(pose, reference)
            if _farthest(found, reference) < FOLLOWED:
                return found
        return self._nearest(pose, reference)

    def _nearest(self, pose: Transform, reference: Sequence[float]) -> Vector6:
        found: list[Vector6] = []
        failure: InverseKinematicsError | None = None
        try:
            found.append(self._corrected(pose, super().solve(pose, reference)))
        except InverseKinematicsError as error:
            failure = error
        if failure or _farthest(found[0], reference) > NEAR:
            with suppress(InverseKinematicsError):
                found.append(self._corrected(pose, reference))
        if failure and not found:
            raise failure
        return min(found, key=lambda q: math.dist(q, reference))

    def _corrected(self, pose: Transform, start: Sequence[float]) -> Vector6:
        """Return the joint angles for `pose` in the neighbourhood of `start`, by Newton's method."""
        q: list[float] = list(start)
        for _ in range(ITERATIONS):
            *joints, flange = self._calibration.frames(q)
            tool = self._tool_behind(flange)
            if not _is_near(tool, pose):
                raise self._no_solution(IkFailure.OUT_OF_REACH, pose)
            error = _difference(tool, pose)
            missed = max(map(abs, error))
            if missed < EXACT:
                break
            jacobian = _jacobian(joints, tool)
            damped = jacobian.T @ jacobian + _DAMPING
            step = np.linalg.solve(damped, jacobian.T @ np.array(error))
            q = [angle + change for angle, change in zip(q, step.tolist(), strict=True)]
        if missed > 100.0 * EXACT or _farthest(q, start) > NEAR:
            raise self._no_solution(IkFailure.OUT_OF_REACH, pose)
        limits = self.model.position_limits
        if any(
            not lower <= angle <= upper
            for angle, lower, upper in zip(q, limits.lower, limits.upper, strict=True)
        ):
            raise self._no_solution(IkFailure.JOINT_LIMITS, pose)
        q1, q2, q3, q4, q5, q6 = q
        return q1, q2, q3, q4, q5, q6

    @override
    def jacobian(self, joints: Vector) -> Array:
        *frames, flange = self._calibration.frames(joints.tolist())
        return _jacobian(frames, self._tool_behind(flange))

    def _tool_behind(self, flange: Transform) -> Transform:
        return flange if self._tool_or_none is None else compose(flange, self._tool_or_none)

    def _no_solution(self, reason: IkFailure, pose: Transform) -> InverseKinematicsError:
        x, y, z = pose.position
        return InverseKinematicsError(
            reason,
            f"the pose at x={x:.4f} y={y:.4f} z={z:.4f} m is {reason.value} with its calibration",
            where=self.model.name,
            remedy="Choose a pose farther from a singularity and from the edge of the workspace.",
        )


def _farthest(q: Sequence[float], reference: Sequence[float]) -> float:
    """Return by how much one of the joints is away from its reference, rad."""
    return max(abs(angle - other) for angle, other in zip(q, reference, strict=True))


def _jacobian(joints: Sequence[Transform], tool: Transform) -> Array:
    """Return the Jacobian (6, 6) at `tool`; each joint turns about z of the frame before its own."""
    x, y, z = tool.position
    columns = []
    for frame in (IDENTITY, *joints):
        ax, ay, az = frame.xz, frame.yz, frame.zz
        dx, dy, dz = x - frame.x, y - frame.y, z - frame.z
        columns.append((ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx, ax, ay, az))
    return np.array(columns).T


def _is_near(present: Transform, wanted: Transform) -> bool:
    """Whether they are turned by less than about 75 degrees: a half turn has no `_difference`."""
    return sum(p * w for p, w in zip(present[:9], wanted[:9], strict=True)) > 1.5


def _difference(present: Transform, wanted: Transform) -> Vector6:
    """Return the twist that takes `present` to `wanted`, a small turn away, in unit time, in base axes."""
    p, w = present, wanted
    return (
        w.x - p.x,
        w.y - p.y,
        w.z - p.z,
        # Half the sum of the cross products of the axes.
        0.5 * (p.yx * w.zx - p.zx * w.yx + p.yy * w.zy - p.zy * w.yy + p.yz * w.zz - p.zz * w.yz),
        0.5 * (p.zx * w.xx - p.xx * w.zx + p.zy * w.xy - p.xy * w.zy + p.zz * w.xz - p.xz * w.zz),
        0.5 * (p.xx * w.yx - p.yx * w.xx + p.xy * w.yy - p.yy * w.xy + p.xz * w.yz - p.yz * w.xz),
    )


def displacements(model: RobotModel, calibration: Calibration) -> list[float]:
    """Return how far, in m, the flange is from where the model has it, in postures spread at random."""
    nominal, random = ArmKinematics(model), Random(7)
    postures = [[random.uniform(-math.pi, math.pi) for _ in range(6)] for _ in range(POSTURES)]
    return [math.dist(nominal.place(q).position, calibration.flange(q).position) for q in postures]
