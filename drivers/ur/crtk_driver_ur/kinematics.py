"""Closed-form kinematics of the Universal Robots arms, in plain Python.

Base frame and angles are the controller's: the base frame of `actual_TCP_pose`, joint angles of
`actual_q`. The constants are the nominal ones of the model; an arm's factory calibration differs
from them by up to some millimetres, which only its controller knows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from enum import Enum
from math import atan2, cos, hypot, sin, sqrt

import numpy as np
from typing_extensions import override

from crtk_driver_ur.frames import IDENTITY, Transform, compose, inverse, pose_of, transform_of
from crtk_driver_ur.models import RobotModel, Vector6
from crtk_drivers.device import Kinematics
from crtk_drivers.errors import KinematicsError
from crtk_drivers.samples import Array, Pose, Vector, vector

__all__ = ["ArmKinematics", "IkFailure", "InverseKinematicsError"]

TURN = 2.0 * math.pi
REACH_TOLERANCE = 1e-10
"""How far, in metres, a pose may lie outside the workspace and still be placed on its edge."""
LIMIT_TOLERANCE = 1e-10
"""How far, in rad, rounding may put a joint beyond its limit; it is then put on the limit."""
WRIST_SINGULAR_SINE = 5e-10
"""Below this |sin q5| only q4 ± q6 is determined; keeping q6 then costs less than 1e-9 rad."""


class IkFailure(Enum):
    """Why a pose has no joint angles."""

    TOO_CLOSE_TO_BASE = "too close to the axis of joint 1"
    OUT_OF_REACH = "out of reach"
    JOINT_LIMITS = "outside the joint limits"


class InverseKinematicsError(KinematicsError):
    """A pose that the arm cannot take; `reason` says why."""

    def __init__(self, reason: IkFailure, message: str, *, where: str, remedy: str) -> None:
        super().__init__(message, where=where, remedy=remedy)
        self.reason = reason


class ArmKinematics(Kinematics):
    """The kinematics of one arm with one tool.

    `forward` and `inverse` are `place` and `solve`, in the core's types.

    Args:
        model: the arm.
        tool: flange to tool centre point (TCP).
    """

    def __init__(self, model: RobotModel, tool: Transform = IDENTITY) -> None:
        self.model = model
        self._tool: Transform | None = None if tool == IDENTITY else tool
        self._tool_inverse = inverse(tool)
        self._lower = model.position_limits.lower
        self._upper = model.position_limits.upper

    @override
    def forward(self, joints: Vector) -> Pose:
        return pose_of(self.place(joints.tolist()))

    @override
    def inverse(self, pose: Pose, reference: Vector) -> Vector:
        return vector(self.solve(transform_of(pose), reference.tolist()))

    def place(self, q: Sequence[float]) -> Transform:
        """Return the pose of the TCP in the base frame for joint angles `q` (6, rad)."""
        flange = self._flange(q)
        return flange if self._tool is None else compose(flange, self._tool)

    def _flange(self, q: Sequence[float]) -> Transform:
        m = self.model
        q1, q2, q3, q4, q5, q6 = q
        s1, c1, s5, c5, s6, c6 = sin(q1), cos(q1), sin(q5), cos(q5), sin(q6), cos(q6)
        q23 = q2 + q3
        s234, c234 = sin(q23 + q4), cos(q23 + q4)
        # x axis of the flange before joint 6 turns it: u; y axis: v
        ux, uy, uz = s1 * s5 + c1 * c234 * c5, s1 * c234 * c5 - c1 * s5, s234 * c5
        vx, vy, vz = -c1 * s234, -s1 * s234, c234
        zx, zy, zz = s1 * c5 - c1 * c234 * s5, -c1 * c5 - s1 * c234 * s5, -s234 * s5
        radius = m.a2 * cos(q2) + m.a3 * cos(q23) + m.d5 * s234
        return Transform(
            c6 * ux + s6 * vx,
            c6 * vx - s6 * ux,
            zx,
            c6 * uy + s6 * vy,
            c6 * vy - s6 * uy,
            zy,
            c6 * uz + s6 * vz,
            c6 * vz - s6 * uz,
            zz,
            c1 * radius + m.d4 * s1 + m.d6 * zx,
            s1 * radius - m.d4 * c1 + m.d6 * zy,
            m.d1 + m.a2 * sin(q2) + m.a3 * sin(q23) - m.d5 * c234 + m.d6 * zz,
        )

    def inverse_all(self, pose: Transform, wrist_3: float = 0.0) -> list[Vector6]:
        """Return every set of joint angles that takes the TCP to `pose`: up to 8, none if none.

        The angles lie within a turn of zero and are not checked against the limits. Where the
        wrist is singular (sin q5 = 0) joint 6 is given the angle `wrist_3`.
        """
        flange = pose if self._tool is None else compose(pose, self._tool_inverse)
        return list(self._solutions(flange, wrist_3))

    def solve(self, pose: Transform, reference: Sequence[float]) -> Vector6:
        """Return the joint angles for `pose` that are nearest to `reference`, within the limits.

        Nearest means the smallest sum of squared joint differences, over all solutions and all
        turns of each joint. At a wrist singularity joint 6 keeps the angle of `reference`.

        Args:
            pose: TCP in the base frame, with an orthonormal rotation.
            reference: joint angles (6, rad), usually the latest setpoint.

        Raises:
            InverseKinematicsError: the pose is out of reach or outside the joint limits.
        """
        flange = pose if self._tool is None else compose(pose, self._tool_inverse)
        best: Vector6 | None = None
        best_distance = math.inf
        found = False
        for solution in self._solutions(flange, reference[5]):
            found = True
            candidate = self._nearest_turns(solution, reference)
            if candidate is None:
                continue
            distance = math.dist(candidate, reference)
            if distance < best_distance:
                best, best_distance = candidate, distance
        if best is None:
            raise self._failure(flange, found)
        return best

    @override
    def jacobian(self, joints: Vector) -> Array:
        """Return the geometric Jacobian of the TCP in base axes (6x6).

        Rows: linear velocity x, y, z (m/s per rad/s), then angular velocity x, y, z.
        """
        m, q = self.model, joints.tolist()
        q1, q2, q3, q4, _, _ = q
        s1, c1 = sin(q1), cos(q1)
        q23 = q2 + q3
        s234, c234 = sin(q23 + q4), cos(q23 + q4)
        _, _, zx, _, _, zy, _, _, zz, fx, fy, fz = self._flange(q)
        if self._tool is None:
            px, py, pz = fx, fy, fz
        else:
            px, py, pz = self.place(q).position
        # Joints 2, 3 and 4 turn about n = (s1, -c1, 0); an offset along n adds nothing.
        r2, h2 = m.a2 * cos(q2), m.d1 + m.a2 * sin(q2)
        r3, h3 = r2 + m.a3 * cos(q23), h2 + m.a3 * sin(q23)
        x5, y5, z5 = c1 * s234, s1 * s234, -c234
        w5, w6 = (c1 * r3 + m.d4 * s1, s1 * r3 - m.d4 * c1, h3), (fx, fy, fz)
        columns = [(-py, px, 0.0, 0.0, 0.0, 1.0)]
        for r, h in ((0.0, m.d1), (r2, h2), (r3, h3)):
            dx, dy, dz = px - c1 * r, py - s1 * r, pz - h
            columns.append((-c1 * dz, -s1 * dz, s1 * dy + c1 * dx, s1, -c1, 0.0))
        for (ax, ay, az), (ox, oy, oz) in (((x5, y5, z5), w5), ((zx, zy, zz), w6)):
            dx, dy, dz = px - ox, py - oy, pz - oz
            columns.append((ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx, ax, ay, az))
        return np.array(columns).T

    def _solutions(self, flange: Transform, wrist_3: float) -> Iterator[Vector6]:
        m = self.model
        xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz = flange
        # Where the axes of joints 5 and 6 meet.
        wx, wy, wz = px - m.d6 * xz, py - m.d6 * yz, pz - m.d6 * zz
        across = hypot(wx, wy)
        if across < m.d4 - REACH_TOLERANCE:
            return
        forward = sqrt(max(0.0, (across - m.d4) * (across + m.d4)))
        direction = atan2(wy, wx)
        for shoulder in (forward, -forward):
            q1 = direction + atan2(m.d4, shoulder)
            s1, c1 = sin(q1), cos(q1)
            # The flange axes seen along the normal of the arm's plane.
            nx, ny = xx * s1 - yx * c1, xy * s1 - yy * c1
            nz = xz * s1 - yz * c1
            sine = hypot(nx, ny)
            for wrist in (sine, -sine):
                q5 = atan2(wrist, nz)
                if sine < WRIST_SINGULAR_SINE:
                    q6 = wrist_3
                else:
                    q6 = atan2(-ny, nx) if wrist > 0.0 else atan2(ny, -nx)
                s6, c6 = sin(q6), cos(q6)
                # The y axis before joint 6 turns it lies in the plane: (-s234, c234).
                c234 = s6 * zx + c6 * zy
                s234 = -c1 * (s6 * xx + c6 * xy) - s1 * (s6 * yx + c6 * yy)
                q234 = atan2(s234, c234)
                s234, c234 = sin(q234), cos(q234)
                r = c1 * wx + s1 * wy - m.d5 * s234
                h = wz - m.d1 + m.d5 * c234
                cosine = (r * r + h * h - m.a2 * m.a2 - m.a3 * m.a3) / (2.0 * m.a2 * m.a3)
                if abs(cosine) > 1.0 + REACH_TOLERANCE:
                    continue
                elbow = sqrt(max(0.0, (1.0 - cosine) * (1.0 + cosine)))
                for bend in (elbow, -elbow):
                    q3 = atan2(bend, cosine)
                    along, aside = m.a2 + m.a3 * cosine, m.a3 * bend
                    q2 = atan2(along * h - aside * r, along * r + aside * h)
                    yield q1, q2, q3, q234 - q2 - q3, q5, q6

    def _nearest_turns(self, q: Vector6, reference: Sequence[float]) -> Vector6 | None:
        """Turn each joint by whole turns to be nearest to `reference` within its limits."""
        turned = []
        for angle, near, lower, upper in zip(q, reference, self._lower, self._upper, strict=True):
            value = angle + TURN * round((near - angle) / TURN)
            if value > upper + LIMIT_TOLERANCE:
                value -= TURN * math.ceil((value - upper - LIMIT_TOLERANCE) / TURN)
            elif value < lower - LIMIT_TOLERANCE:
                value += TURN * math.ceil((lower - value - LIMIT_TOLERANCE) / TURN)
            if not lower - LIMIT_TOLERANCE <= value <= upper + LIMIT_TOLERANCE:
                return None
            turned.append(min(max(value, lower), upper))
        q1, q2, q3, q4, q5, q6 = turned
        return q1, q2, q3, q4, q5, q6

    def _failure(self, flange: Transform, found: bool) -> InverseKinematicsError:
        m = self.model
        x, y, z = flange.position
        if found:
            reason = IkFailure.JOINT_LIMITS
            remedy = "Choose another orientation, or a pose on the other side of the arm."
        elif hypot(x - m.d6 * flange.xz, y - m.d6 * flange.yz) < m.d4 - REACH_TOLERANCE:
            reason = IkFailure.TOO_CLOSE_TO_BASE
            remedy = f"Keep wrist 2 at least {m.d4:.3f} m away from the axis of joint 1."
        else:
            reason = IkFailure.OUT_OF_REACH
            remedy = f"The links reach {abs(m.a2 + m.a3):.3f} m from the shoulder to wrist 1."
        message = f"the flange pose at x={x:.4f} y={y:.4f} z={z:.4f} m is {reason.value}"
        return InverseKinematicsError(reason, message, where=m.name, remedy=remedy)
