"""Torques of a UR arm: point masses at the centres of mass, rotor inertia at the joints."""

from __future__ import annotations

from math import cos, sin, sqrt

from crtk_sim_backends.ur.motion.kinematics import (
    Floats,
    Kinematics,
    Matrix,
    Transform,
    cross,
    rotate,
    rotate_back,
)

_ROTOR_INERTIA_PER_TORQUE = 0.01  # kg m^2 behind the gear, for each N.m of torque limit
_NO_INERTIA = (0.0,) * 6


class Dynamics:
    """Joint torques and mass matrix of one arm. All torques in N.m, positive along the joint."""

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._model = kinematics.model
        self._rotor = [_ROTOR_INERTIA_PER_TORQUE * torque for torque in self._model.torque]

    def torques(
        self,
        q: Floats,
        qdd: Floats,
        payload: float,
        cog: Floats,
        gravity: Floats,
        flange: Transform | None = None,
    ) -> tuple[float, ...]:
        """Torques that hold the arm at `q` (rad) against gravity and accelerate it by `qdd`.

        `payload` (kg) with its centre `cog` (m, flange frame) is part of the last link;
        `gravity` is the upward acceleration that the base feels, m/s^2. The inertia is that of
        the diagonal of the mass matrix; centrifugal torques are left out. `flange` saves time
        where the transform of the flange at `q` is known.
        """
        axes, origins, links = self._geometry(q, payload, cog, flange or self._kinematics.flange(q))
        gx, gy, gz = gravity
        accelerating = any(qdd)
        torques = [0.0] * 6
        # Moments of what the joint carries: mass, mass times centre, second moments.
        mass = x = y = z = xx = yy = zz = xy = xz = yz = 0.0
        for i in range(len(links) - 1, -1, -1):
            m, (cx, cy, cz) = links[i]
            mx = m * cx
            my = m * cy
            mz = m * cz
            mass += m
            x += mx
            y += my
            z += mz
            if accelerating:
                xx += mx * cx
                yy += my * cy
                zz += mz * cz
                xy += mx * cy
                xz += mx * cz
                yz += my * cz
            if i > 5:
                continue
            ax, ay, az = axes[i]
            ox, oy, oz = origins[i]
            dx = x - mass * ox
            dy = y - mass * oy
            dz = z - mass * oz
            torque = (ay * dz - az * dy) * gx + (az * dx - ax * dz) * gy + (ax * dy - ay * dx) * gz
            if accelerating:
                # Moment of inertia about the axis: sum of m (r.r - (a.r)^2), r = centre - origin.
                along = ax * ox + ay * oy + az * oz
                square = xx + yy + zz - ox * (x + dx) - oy * (y + dy) - oz * (z + dz)
                projected = (
                    ax * (ax * xx + 2 * (ay * xy + az * xz))
                    + ay * (ay * yy + 2 * az * yz)
                    + az * az * zz
                    - along * (2 * (ax * x + ay * y + az * z) - mass * along)
                )
                torque += (self._rotor[i] + square - projected) * qdd[i]
            torques[i] = torque
        return tuple(torques)

    def mass_matrix(
        self,
        q: Floats,
        payload: float,
        cog: Floats,
        inertia: Floats = _NO_INERTIA,
        rotors: bool = True,
    ) -> Matrix:
        """Mass matrix (6x6), kg m^2, with the inertia of the motors' `rotors` or without.

        `inertia` of the payload about its centre: Ixx Iyy Izz Ixy Ixz Iyz in flange axes.
        """
        flange = self._kinematics.flange(q)
        axes, origins, links = self._geometry(q, payload, cog, flange)
        matrix = [[0.0] * 6 for _ in range(6)]
        for last, (mass, centre) in enumerate(links):
            columns = [
                cross(axes[i], [c - o for c, o in zip(centre, origins[i], strict=True)])
                for i in range(min(last, 5) + 1)
            ]
            for i, u in enumerate(columns):
                for j, v in enumerate(columns):
                    matrix[i][j] += mass * (u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
        if any(inertia):
            turned = [_turn_inertia(flange, inertia, axis) for axis in axes]
            for i in range(6):
                for j in range(6):
                    matrix[i][j] += _dot(axes[i], turned[j])
        if rotors:
            for i in range(6):
                matrix[i][i] += self._rotor[i]
        return matrix

    def coriolis(
        self,
        q: Floats,
        qd: Floats,
        payload: float,
        cog: Floats,
        inertia: Floats = _NO_INERTIA,
    ) -> list[float]:
        """Coriolis and centrifugal torques, N.m: inverse dynamics at constant joint speeds."""
        flange = self._kinematics.flange(q)
        axes, origins, links = self._geometry(q, payload, cog, flange)
        spin: Floats = (0.0, 0.0, 0.0)
        turning: Floats = spin  # angular acceleration
        pulling: Floats = spin  # acceleration of the joint
        forces: list[tuple[Floats, Floats]] = []
        for i in range(6):
            turn = [a * qd[i] for a in axes[i]]
            turning = _sum(turning, cross(spin, turn))
            spin = _sum(spin, turn)
            for mass, centre in links[i:] if i == 5 else links[i : i + 1]:
                acceleration = _carried(pulling, spin, turning, centre, origins[i])
                forces.append(([mass * a for a in acceleration], centre))
            if i < 5:
                pulling = _carried(pulling, spin, turning, origins[i + 1], origins[i])
        moment: Floats = (0.0, 0.0, 0.0)
        if any(inertia):
            gyration = cross(spin, _turn_inertia(flange, inertia, spin))
            moment = _sum(_turn_inertia(flange, inertia, turning), gyration)
        total: Floats = (0.0, 0.0, 0.0)
        torques = [0.0] * 6
        for i in range(5, -1, -1):
            for force, centre in forces[i:] if i == 5 else forces[i : i + 1]:
                total = _sum(total, force)
                moment = _sum(moment, cross(centre, force))
            lever = cross(origins[i], total)
            torques[i] = _dot(axes[i], [m - x for m, x in zip(moment, lever, strict=True)])
        return torques

    def _geometry(
        self, q: Floats, payload: float, cog: Floats, flange: Transform
    ) -> tuple[list[Floats], list[Floats], list[tuple[float, Floats]]]:
        """Joint axes, joint origins, and (mass, centre) of the six links and the payload."""
        model = self._model
        d1, _, _, d4, d5, _ = model.d
        a2 = model.a[1]
        a3 = model.a[2]
        q1, q2, q3, q4, q5, _ = q
        s1 = sin(q1)
        c1 = cos(q1)
        s2 = sin(q2)
        c2 = cos(q2)
        s23 = sin(q2 + q3)
        c23 = cos(q2 + q3)
        s234 = sin(q2 + q3 + q4)
        c234 = cos(q2 + q3 + q4)
        s5 = sin(q5)
        c5 = cos(q5)
        z2 = (s1, -c1, 0.0)  # axes of joints 2, 3 and 4
        z5 = (c1 * s234, s1 * s234, -c234)
        z6 = (flange[2], flange[5], flange[8])
        x5 = (c1 * c234 * c5 + s1 * s5, s1 * c234 * c5 - c1 * s5, s234 * c5)
        shoulder = (0.0, 0.0, d1)
        elbow = (a2 * c1 * c2, a2 * s1 * c2, d1 + a2 * s2)
        wrist1 = (elbow[0] + a3 * c1 * c23, elbow[1] + a3 * s1 * c23, elbow[2] + a3 * s23)
        wrist2 = (wrist1[0] + d4 * s1, wrist1[1] - d4 * c1, wrist1[2])
        wrist3 = (wrist2[0] + d5 * z5[0], wrist2[1] + d5 * z5[1], wrist2[2] + d5 * z5[2])
        tip = (flange[9], flange[10], flange[11])
        frames = (
            (shoulder, (c1, s1, 0.0), (0.0, 0.0, 1.0), z2),
            (elbow, (c1 * c2, s1 * c2, s2), (-c1 * s2, -s1 * s2, c2), z2),
            (wrist1, (c1 * c23, s1 * c23, s23), (-c1 * s23, -s1 * s23, c23), z2),
            (wrist2, (c1 * c234, s1 * c234, s234), z2, z5),
            (wrist3, x5, (-z5[0], -z5[1], -z5[2]), z6),
            (tip, (flange[0], flange[3], flange[6]), (flange[1], flange[4], flange[7]), z6),
        )
        links: list[tuple[float, Floats]] = [
            (
                mass,
                (
                    ox + x * ex + y * fx + z * gx,
                    oy + x * ey + y * fy + z * gy,
                    oz + x * ez + y * fz + z * gz,
                ),
            )
            for mass, (x, y, z), (
                (ox, oy, oz),
                (ex, ey, ez),
                (fx, fy, fz),
                (gx, gy, gz),
            ) in zip(model.mass, model.cog, frames, strict=True)
        ]
        if payload:
            x, y, z = rotate(flange, cog)
            links.append((payload, (tip[0] + x, tip[1] + y, tip[2] + z)))
        axes: list[Floats] = [(0.0, 0.0, 1.0), z2, z2, z2, z5, z6]
        origins: list[Floats] = [shoulder, shoulder, elbow, wrist1, wrist2, wrist3]
        return axes, origins, links


def solve(matrix: Matrix, vector: Floats) -> list[float]:
    """Solution x of matrix . x = vector, for a symmetric positive definite 6x6 matrix."""
    lower = [[0.0] * 6 for _ in range(6)]
    half = [0.0] * 6
    for i in range(6):
        row = lower[i]
        for j in range(i + 1):
            other = lower[j]
            value = matrix[i][j] - sum([row[k] * other[k] for k in range(j)])
            row[j] = sqrt(value) if i == j else value / other[j]
        half[i] = (vector[i] - sum([row[k] * half[k] for k in range(i)])) / row[i]
    x = [0.0] * 6
    for i in range(5, -1, -1):
        x[i] = (half[i] - sum([lower[k][i] * x[k] for k in range(i + 1, 6)])) / lower[i][i]
    return x


def _carried(
    pulling: Floats, spin: Floats, turning: Floats, point: Floats, origin: Floats
) -> tuple[float, float, float]:
    """Acceleration of a point of a body whose `origin` accelerates with `pulling`."""
    arm = [p - o for p, o in zip(point, origin, strict=True)]
    return _sum(_sum(pulling, cross(turning, arm)), cross(spin, cross(spin, arm)))


def _sum(a: Floats, b: Floats) -> tuple[float, float, float]:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _dot(a: Floats, b: Floats) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _turn_inertia(flange: Transform, inertia: Floats, axis: Floats) -> tuple[float, float, float]:
    """Product of an inertia tensor in flange axes and a vector in base axes, in base axes."""
    xx, yy, zz, xy, xz, yz = inertia
    x, y, z = rotate_back(flange, axis)
    return rotate(
        flange, (xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z)
    )
