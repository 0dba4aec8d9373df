"""Orientations that change: rotation vectors over time, and what they are in angular velocity.

An orientation is written as ``exp(r) * centre``, r a rotation vector in base axes. All angular quantities
are in base axes, too.
"""

from __future__ import annotations

import math

from crtk_drivers.geometry.quaternions import quaternion_product, rotvec_from_quaternion
from crtk_drivers.samples import Vector, vector

_SMALL = 1e-2
"""Angles in rad below which series are used: the quotients would lose digits."""

Triple = tuple[float, float, float]


def inverse(quaternion: Vector) -> Vector:
    """Return the inverse of a unit quaternion (4,)."""
    x, y, z, w = quaternion.tolist()
    return vector((-x, -y, -z, w))


def turn(to: Vector, start: Vector) -> Vector:
    """Return the rotation vector (3,) in rad that takes quaternion `start` to `to`, of at most pi."""
    return rotvec_from_quaternion(quaternion_product(to, inverse(start)))


def angular_velocity(rotvec: Vector, rate: Vector) -> Vector:
    """Return the angular velocity (3,) of ``exp(rotvec)`` while `rotvec` changes at `rate`."""
    first, second, _, _ = _factors(rotvec)
    r, v = rotvec.tolist(), rate.tolist()
    across = cross(r, v)
    again = cross(r, across)
    return vector([v[i] + first * across[i] + second * again[i] for i in range(3)])


def angular_acceleration(rotvec: Vector, rate: Vector, change: Vector) -> Vector:
    """Return the derivative (3,) of `angular_velocity`, where `rate` changes at `change`."""
    first, second, first_slope, second_slope = _factors(rotvec)
    r, v, a = rotvec.tolist(), rate.tolist(), change.tolist()
    growth = r[0] * v[0] + r[1] * v[1] + r[2] * v[2]  # angle times its derivative
    across, again = cross(r, v), cross(r, cross(r, v))
    turned, spun = cross(r, a), cross(v, across)
    twice = cross(r, turned)
    return vector(
        [
            a[i]
            + first * turned[i]
            + second * (spun[i] + twice[i])
            + growth * (first_slope * across[i] + second_slope * again[i])
            for i in range(3)
        ]
    )


def cross(a: Triple | list[float], b: Triple | list[float]) -> Triple:
    """Return the cross product of three numbers and three numbers."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _factors(rotvec: Vector) -> tuple[float, float, float, float]:
    """Return (1-cos x)/x², (x-sin x)/x³ and their derivatives by x divided by x, for the angle x."""
    x, y, z = rotvec.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < _SMALL:
        square = angle * angle
        return (
            0.5 - square / 24.0 + square * square / 720.0,
            1.0 / 6.0 - square / 120.0 + square * square / 5040.0,
            -1.0 / 12.0 + square / 180.0,
            -1.0 / 60.0 + square / 1260.0,
        )
    sine, cosine = math.sin(angle), math.cos(angle)
    first = (1.0 - cosine) / angle**2
    second = (angle - sine) / angle**3
    return (
        first,
        second,
        (sine / angle - 2.0 * first) / angle**2,
        (first - 3.0 * second) / angle**2,
    )
