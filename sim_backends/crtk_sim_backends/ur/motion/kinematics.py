"""Kinematics of a UR arm in closed form, and the arithmetic of poses. Pure Python and fast.

A *pose* is six floats: position in m and rotation vector in rad. A *transform* is a tuple of
twelve floats: the rotation matrix row by row, then the translation. Frames follow the DH
convention of Universal Robots; the flange frame is frame 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import acos, atan2, copysign, cos, hypot, pi, remainder, sin, sqrt
from typing import TypeAlias

from crtk_sim_backends.ur.models import RobotModel

Floats: TypeAlias = Sequence[float]
Transform: TypeAlias = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float
]
Matrix: TypeAlias = list[list[float]]

IDENTITY: Transform = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
_REACH_TOLERANCE = 1e-7  # of the cosine of the elbow; less than 0.1 um at the tool
_SINGULAR_SINE = 1e-8
_SIGNS = (1.0, -1.0)
_SAME_BRANCH = 0.1  # rad from where the arm was: farther away another branch may be nearer


def rotation_matrix(x: float, y: float, z: float) -> tuple[float, ...]:
    """Rotation matrix, nine floats row by row, of the rotation vector (x, y, z)."""
    angle = sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return (1.0, -z, y, z, 1.0, -x, -y, x, 1.0)
    x /= angle
    y /= angle
    z /= angle
    c = cos(angle)
    s = sin(angle)
    v = 1.0 - c
    xyv = x * y * v
    xzv = x * z * v
    yzv = y * z * v
    return (
        x * x * v + c,
        xyv - z * s,
        xzv + y * s,
        xyv + z * s,
        y * y * v + c,
        yzv - x * s,
        xzv - y * s,
        yzv + x * s,
        z * z * v + c,
    )


def rotation_vector(t: Floats) -> tuple[float, float, float]:
    """Rotation vector of a rotation matrix (nine floats) or transform, angle within [0, pi]."""
    sx = t[7] - t[5]
    sy = t[2] - t[6]
    sz = t[3] - t[1]
    s = sqrt(sx * sx + sy * sy + sz * sz)  # 2 sin(angle)
    c = t[0] + t[4] + t[8] - 1.0  # 2 cos(angle)
    if s > 1e-6:
        k = atan2(s, c) / s
        return (sx * k, sy * k, sz * k)
    if c > 0.0:
        return (sx / 2, sy / 2, sz / 2)
    x = sqrt(max(0.0, (t[0] + 1.0) / 2))
    y = sqrt(max(0.0, (t[4] + 1.0) / 2))
    z = sqrt(max(0.0, (t[8] + 1.0) / 2))
    if x >= y and x >= z:
        y = copysign(y, t[1])
        z = copysign(z, t[2])
    elif y >= z:
        x = copysign(x, t[1])
        z = copysign(z, t[5])
    else:
        x = copysign(x, t[2])
        y = copysign(y, t[5])
    angle = atan2(s, c)
    return (x * angle, y * angle, z * angle)


def to_transform(pose: Floats) -> Transform:
    """Transform of a pose."""
    return (*rotation_matrix(pose[3], pose[4], pose[5]), pose[0], pose[1], pose[2])  # type: ignore[return-value]


def to_pose(t: Transform) -> tuple[float, ...]:
    """Pose of a transform."""
    return (t[9], t[10], t[11], *rotation_vector(t))


def compose(a: Transform, b: Transform) -> Transform:
    """Transform a . b."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8, ax, ay, az = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8, bx, by, bz = b
    return (
        a0 * b0 + a1 * b3 + a2 * b6,
        a0 * b1 + a1 * b4 + a2 * b7,
        a0 * b2 + a1 * b5 + a2 * b8,
        a3 * b0 + a4 * b3 + a5 * b6,
        a3 * b1 + a4 * b4 + a5 * b7,
        a3 * b2 + a4 * b5 + a5 * b8,
        a6 * b0 + a7 * b3 + a8 * b6,
        a6 * b1 + a7 * b4 + a8 * b7,
        a6 * b2 + a7 * b5 + a8 * b8,
        a0 * bx + a1 * by + a2 * bz + ax,
        a3 * bx + a4 * by + a5 * bz + ay,
        a6 * bx + a7 * by + a8 * bz + az,
    )


def invert(t: Transform) -> Transform:
    """Inverse transform."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8, x, y, z = t
    return (
        r0,
        r3,
        r6,
        r1,
        r4,
        r7,
        r2,
        r5,
        r8,
        -(r0 * x + r3 * y + r6 * z),
        -(r1 * x + r4 * y + r7 * z),
        -(r2 * x + r5 * y + r8 * z),
    )


def rotate(t: Floats, v: Floats) -> tuple[float, float, float]:
    """Vector `v` turned by the rotation of `t`."""
    x, y, z = v
    return (
        t[0] * x + t[1] * y + t[2] * z,
        t[3] * x + t[4] * y + t[5] * z,
        t[6] * x + t[7] * y + t[8] * z,
    )


def rotate_back(t: Floats, v: Floats) -> tuple[float, float, float]:
    """Vector `v` turned by the inverse rotation of `t`."""
    x, y, z = v
    return (
        t[0] * x + t[3] * y + t[6] * z,
        t[1] * x + t[4] * y + t[7] * z,
        t[2] * x + t[5] * y + t[8] * z,
    )


def cross(a: Floats, b: Floats) -> tuple[float, float, float]:
    """Cross product of two 3-vectors."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def norm(v: Floats) -> float:
    """Euclidean length."""
    return sqrt(sum(x * x for x in v))


def pose_trans(a: Floats, b: Floats) -> tuple[float, ...]:
    """Pose of a . b, as URScript `pose_trans`."""
    return to_pose(compose(to_transform(a), to_transform(b)))


def pose_inv(pose: Floats) -> tuple[float, ...]:
    """Pose of the inverse, as URScript `pose_inv`."""
    return to_pose(invert(to_transform(pose)))


def pose_sub(a: Floats, b: Floats) -> tuple[float, ...]:
    """Difference a - b: translations subtract, the rotation is R_a . R_b^-1 (URScript `pose_sub`)."""
    ta = to_transform(a)
    tb = to_transform(b)
    difference = compose(
        (*ta[:9], 0.0, 0.0, 0.0),
        invert((*tb[:9], 0.0, 0.0, 0.0)),
    )
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2], *rotation_vector(difference))


def pose_add(a: Floats, b: Floats) -> tuple[float, ...]:
    """Sum: translations add, the rotation is R_a . R_b (URScript `pose_add`)."""
    ta = to_transform(a)
    tb = to_transform(b)
    rotation = compose((*ta[:9], 0.0, 0.0, 0.0), (*tb[:9], 0.0, 0.0, 0.0))
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], *rotation_vector(rotation))


def pose_distance(a: Floats, b: Floats) -> float:
    """Distance between the origins of two poses, m (URScript `pose_dist`)."""
    return sqrt(sum((x - y) ** 2 for x, y in zip(a[:3], b[:3], strict=True)))


def interpolate_pose(a: Floats, b: Floats, fraction: float) -> tuple[float, ...]:
    """Pose at `fraction` between `a` (0) and `b` (1): straight line and single-axis rotation."""
    ta = to_transform(a)
    relative = compose(invert(ta), to_transform(b))
    x, y, z = rotation_vector(relative)
    turned: Transform = (
        *rotation_matrix(x * fraction, y * fraction, z * fraction),
        relative[9] * fraction,
        relative[10] * fraction,
        relative[11] * fraction,
    )  # type: ignore[assignment]
    return to_pose(compose(ta, turned))


def joint_rates(
    jacobian: Sequence[Floats], twist: Floats, tolerance: float = 1e-6
) -> list[float] | None:
    """Joint rates that move the tool with `twist`, None where a determinant is below `tolerance`.

    Seen along and across the plane in which joints 2 to 4 turn, the equations fall into two times
    three: joints 1, 5 and 6 alone move the tool across that plane and turn it out of it.
    """
    x, y, z, turn_x, turn_y, turn_z = jacobian
    s = turn_x[1]  # the axis of joints 2 to 4 is (s, -c, 0)
    c = -turn_y[1]
    vx, vy, vz, wx, wy, wz = twist
    across_1 = s * x[0] - c * y[0]
    across_5 = s * x[4] - c * y[4] - across_1 * turn_z[4]
    across_6 = s * x[5] - c * y[5] - across_1 * turn_z[5]
    tilt_5 = c * turn_x[4] + s * turn_y[4]
    tilt_6 = c * turn_x[5] + s * turn_y[5]
    determinant = across_5 * tilt_6 - across_6 * tilt_5
    if abs(determinant) < tolerance:
        return None
    across = s * vx - c * vy - across_1 * wz
    tilt = c * wx + s * wy
    q5 = (across * tilt_6 - across_6 * tilt) / determinant
    q6 = (across_5 * tilt - across * tilt_5) / determinant
    q1 = wz - turn_z[4] * q5 - turn_z[5] * q6
    # What is left for joints 2 to 4, whose rates add up to `turn`.
    turn = s * (wx - turn_x[4] * q5 - turn_x[5] * q6) - c * (wy - turn_y[4] * q5 - turn_y[5] * q6)
    along_2 = c * x[1] + s * y[1]
    along_3 = c * x[2] + s * y[2] - along_2
    along_4 = c * x[3] + s * y[3] - along_2
    up_2 = z[1]
    up_3 = z[2] - up_2
    up_4 = z[3] - up_2
    determinant = along_3 * up_4 - along_4 * up_3
    if abs(determinant) < tolerance:
        return None
    along = (
        c * (vx - x[0] * q1 - x[4] * q5 - x[5] * q6)
        + s * (vy - y[0] * q1 - y[4] * q5 - y[5] * q6)
        - along_2 * turn
    )
    up = vz - z[4] * q5 - z[5] * q6 - up_2 * turn
    q3 = (along * up_4 - along_4 * up) / determinant
    q4 = (along_3 * up - along * up_3) / determinant
    return [q1, turn - q3 - q4, q3, q4, q5, q6]


def multiply(matrix: Sequence[Floats], vector: Floats) -> tuple[float, ...]:
    """Product of a 6x6 matrix and a 6-vector."""
    a, b, c, d, e, f = vector
    r0, r1, r2, r3, r4, r5 = matrix
    return (
        r0[0] * a + r0[1] * b + r0[2] * c + r0[3] * d + r0[4] * e + r0[5] * f,
        r1[0] * a + r1[1] * b + r1[2] * c + r1[3] * d + r1[4] * e + r1[5] * f,
        r2[0] * a + r2[1] * b + r2[2] * c + r2[3] * d + r2[4] * e + r2[5] * f,
        r3[0] * a + r3[1] * b + r3[2] * c + r3[3] * d + r3[4] * e + r3[5] * f,
        r4[0] * a + r4[1] * b + r4[2] * c + r4[3] * d + r4[4] * e + r4[5] * f,
        r5[0] * a + r5[1] * b + r5[2] * c + r5[3] * d + r5[4] * e + r5[5] * f,
    )


def transpose_multiply(matrix: Sequence[Floats], vector: Floats) -> list[float]:
    """Product of the transpose of a 6x6 matrix and a 6-vector."""
    a, b, c, d, e, f = vector
    r0, r1, r2, r3, r4, r5 = matrix
    return [r0[i] * a + r1[i] * b + r2[i] * c + r3[i] * d + r4[i] * e + r5[i] * f for i in range(6)]


class Kinematics:
    """Forward kinematics, inverse kinematics and Jacobian of one arm model."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self._d1, _, _, self._d4, self._d5, self._d6 = model.d
        self._a2 = model.a[1]
        self._a3 = model.a[2]

    def flange(self, q: Floats) -> Transform:
        """Transform from base to flange at joint positions `q`, rad."""
        q1, q2, q3, q4, q5, q6 = q
        q23 = q2 + q3
        q234 = q23 + q4
        s1 = sin(q1)
        c1 = cos(q1)
        s234 = sin(q234)
        c234 = cos(q234)
        s5 = sin(q5)
        c5 = cos(q5)
        s6 = sin(q6)
        c6 = cos(q6)
        ux = s1 * s5 + c1 * c234 * c5
        uy = -c1 * s5 + s1 * c234 * c5
        uz = s234 * c5
        wx = s1 * c5 - c1 * c234 * s5
        wy = -c1 * c5 - s1 * c234 * s5
        wz = -s234 * s5
        d4 = self._d4
        d5 = self._d5
        d6 = self._d6
        a2 = self._a2
        a3 = self._a3
        radius = a2 * cos(q2) + a3 * cos(q23) + d5 * s234
        return (
            c6 * ux - s6 * c1 * s234,
            -s6 * ux - c6 * c1 * s234,
            wx,
            c6 * uy - s6 * s1 * s234,
            -s6 * uy - c6 * s1 * s234,
            wy,
            c6 * uz + s6 * c234,
            -s6 * uz + c6 * c234,
            wz,
            c1 * radius + d4 * s1 + d6 * wx,
            s1 * radius - d4 * c1 + d6 * wy,
            self._d1 + a2 * sin(q2) + a3 * sin(q23) - d5 * c234 + d6 * wz,
        )

    def forward(self, q: Floats, tool: Transform = IDENTITY) -> tuple[float, ...]:
        """Pose of the tool (flange offset `tool`) in the base frame."""
        t = self.flange(q)
        return to_pose(t if tool is IDENTITY else compose(t, tool))

    def elbow(self, q: Floats, qd: Floats) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Position, m, and velocity, m/s, of the elbow."""
        s1 = sin(q[0])
        c1 = cos(q[0])
        radius = self._a2 * cos(q[1])
        height = self._a2 * sin(q[1])
        x = radius * c1
        y = radius * s1
        turn, lift = qd[0], qd[1]
        velocity = (
            -y * turn - height * c1 * lift,
            x * turn - height * s1 * lift,
            radius * lift,
        )
        return (x, y, self._d1 + height), velocity

    def jacobian(
        self, q: Floats, tool: Transform = IDENTITY, flange: Transform | None = None
    ) -> Matrix:
        """Geometric Jacobian (6x6): joint rates to tool velocity and angular velocity in base.

        `flange` saves time where the transform of the flange at `q` is known.
        """
        q1, q2, q3, q4, q5, _ = q
        q23 = q2 + q3
        q234 = q23 + q4
        s1 = sin(q1)
        c1 = cos(q1)
        s234 = sin(q234)
        c234 = cos(q234)
        s5 = sin(q5)
        c5 = cos(q5)
        # Joint axes 2 to 4 are (s1, -c1, 0); then 5 and 6:
        ax = c1 * s234
        ay = s1 * s234
        az = -c234
        bx = s1 * c5 - c1 * c234 * s5
        by = -c1 * c5 - s1 * c234 * s5
        bz = -s234 * s5
        # Vectors from the joints to the tool, from the last joint back.
        d6 = self._d6
        x = d6 * bx
        y = d6 * by
        z = d6 * bz
        if tool is not IDENTITY:
            t = flange or self.flange(q)
            tx, ty, tz = tool[9], tool[10], tool[11]
            x += t[0] * tx + t[1] * ty + t[2] * tz
            y += t[3] * tx + t[4] * ty + t[5] * tz
            z += t[6] * tx + t[7] * ty + t[8] * tz
        j05 = by * z - bz * y
        j15 = bz * x - bx * z
        j25 = bx * y - by * x
        d5 = self._d5
        d4 = self._d4
        x += d5 * ax
        y += d5 * ay
        z += d5 * az
        j04 = ay * z - az * y
        j14 = az * x - ax * z
        j24 = ax * y - ay * x
        x += d4 * s1
        y -= d4 * c1
        j23 = s1 * y + c1 * x
        j03 = -c1 * z
        j13 = -s1 * z
        radius = self._a3 * cos(q23)
        x += radius * c1
        y += radius * s1
        z += self._a3 * sin(q23)
        j22 = s1 * y + c1 * x
        j02 = -c1 * z
        j12 = -s1 * z
        radius = self._a2 * cos(q2)
        x += radius * c1
        y += radius * s1
        z += self._a2 * sin(q2)
        return [
            [-y, -c1 * z, j02, j03, j04, j05],
            [x, -s1 * z, j12, j13, j14, j15],
            [0.0, s1 * y + c1 * x, j22, j23, j24, j25],
            [0.0, s1, s1, s1, ax, bx],
            [0.0, -c1, -c1, -c1, ay, by],
            [1.0, 0.0, 0.0, 0.0, az, bz],
        ]

    def inverse_all(self, t: Transform, wrist_3: float = 0.0) -> list[list[float]]:
        """Return up to eight joint positions, rad, that bring the flange to `t`.

        At a wrist singularity joint 6 is free; `wrist_3` is used for it.
        """
        solutions = []
        for shoulder in self._shoulders(t):
            for wrist in _SIGNS:
                for elbow in _SIGNS:
                    q = self._branch(t, shoulder, wrist, elbow, wrist_3)
                    if q is not None:
                        solutions.append(q)
        return solutions

    def _shoulders(self, t: Transform) -> tuple[float, ...]:
        """Positions of joint 1, rad, that can bring the flange to `t`: two or none."""
        x = t[9] - self._d6 * t[2]
        y = t[10] - self._d6 * t[5]
        h = hypot(x, y)
        if h < abs(self._d4):
            return ()
        psi = atan2(y, x) + pi / 2
        phi = acos(self._d4 / h)
        return psi + phi, psi - phi

    def _branch(
        self, t: Transform, q1: float, wrist: float, elbow: float, wrist_3: float
    ) -> list[float] | None:
        """Joint positions with joint 1 at `q1` and joints 5 and 3 of the signs `wrist`, `elbow`."""
        r0, r1, r2, r3, r4, r5, r6, r7, r8, px, py, pz = t
        d5 = self._d5
        d6 = self._d6
        a2 = self._a2
        a3 = self._a3
        s1 = sin(q1)
        c1 = cos(q1)
        # Sine and cosine of q5 from the orientation: exact even near the wrist singularity.
        u = r4 * c1 - r1 * s1
        v = r0 * s1 - r3 * c1
        size = hypot(u, v)
        q5 = copysign(atan2(size, r2 * s1 - r5 * c1), wrist)
        q6 = atan2(wrist * u, wrist * v) if size > _SINGULAR_SINE else wrist_3
        s6 = sin(q6)
        c6 = cos(q6)
        s234 = -(s6 * (c1 * r0 + s1 * r3) + c6 * (c1 * r1 + s1 * r4))
        c234 = s6 * r6 + c6 * r7
        x = c1 * (px - d6 * r2) + s1 * (py - d6 * r5) - d5 * s234
        z = pz - d6 * r8 - self._d1 + d5 * c234
        c3 = (x * x + z * z - a2 * a2 - a3 * a3) / (2 * a2 * a3)
        if abs(c3) > 1.0 + _REACH_TOLERANCE:
            return None
        q3 = copysign(acos(max(-1.0, min(1.0, c3))), elbow)
        k1 = a2 + a3 * cos(q3)
        k2 = a3 * sin(q3)
        q2 = atan2(k1 * z - k2 * x, k1 * x + k2 * z)
        return [q1, q2, q3, atan2(s234, c234) - q2 - q3, q5, q6]

    def inverse(self, t: Transform, near: Floats, tool: Transform = IDENTITY) -> list[float] | None:
        """Joint positions nearest to `near` that bring the tool to `t`, None when out of reach.

        Each joint is turned by whole turns towards `near`, as far as its limits allow.
        """
        flange = t if tool is IDENTITY else compose(t, invert(tool))
        best: list[float] | None = None
        smallest = 1e9
        for q in self.inverse_all(flange, near[5]):
            largest = self._unwind(q, near)
            if largest < smallest:
                smallest = largest
                best = q
        return best

    def follow(self, t: Transform, near: Floats, tool: Transform = IDENTITY) -> list[float] | None:
        """Do the same as `inverse`, faster where the arm stays in the branch of `near`."""
        flange = t if tool is IDENTITY else compose(t, invert(tool))
        shoulders = self._shoulders(flange)
        if shoulders:
            q1 = min(shoulders, key=lambda angle: abs(remainder(angle - near[0], 2 * pi)))
            wrist = remainder(near[4], 2 * pi)
            elbow = remainder(near[2], 2 * pi)
            q = self._branch(flange, q1, copysign(1.0, wrist), copysign(1.0, elbow), near[5])
            if q is not None and self._unwind(q, near) < _SAME_BRANCH:
                return q
        return self.inverse(t, near, tool)

    def _unwind(self, q: list[float], near: Floats) -> float:
        """Turn the joints of `q` by whole turns towards `near`; the largest distance left, rad."""
        largest = 0.0
        for i, limit in enumerate(self.model.position):
            value = q[i]
            distance = near[i] - value
            if distance > pi or distance < -pi:
                value += 2 * pi * round(distance / (2 * pi))
            if value > limit:
                value -= 2 * pi
            elif value < -limit:
                value += 2 * pi
            q[i] = value
            distance = abs(value - near[i])
            if distance > largest:
                largest = distance
        return largest
