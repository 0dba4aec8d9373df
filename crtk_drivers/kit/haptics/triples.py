"""Three numbers as plain tuples: at 4 kHz an array of numpy costs more than what is reckoned with it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

Triple: TypeAlias = tuple[float, float, float]
Quadruple: TypeAlias = tuple[float, float, float, float]

ZERO: Final[Triple] = (0.0, 0.0, 0.0)

Wrench6: TypeAlias = tuple[Triple, Triple]
"""A force in N and a torque in N·m."""


def plus(a: Triple, b: Triple) -> Triple:
    """Return the sum."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Triple, b: Triple) -> Triple:
    """Return the difference."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def times(a: Triple, factor: float) -> Triple:
    """Return the product with a number."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def dot(a: Triple, b: Triple) -> float:
    """Return the inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def size(a: Triple) -> float:
    """Return the length."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def turn(to: Quadruple, start: Quadruple) -> Triple:
    """Return the rotation vector, in rad and base axes, from one unit quaternion (x, y, z, w) to another."""
    ax, ay, az, aw = to
    bx, by, bz, bw = start
    x = -aw * bx + ax * bw - ay * bz + az * by
    y = -aw * by + ay * bw - az * bx + ax * bz
    z = -aw * bz + az * bw - ax * by + ay * bx
    w = aw * bw + ax * bx + ay * by + az * bz
    half = math.sqrt(x * x + y * y + z * z)
    if half < 1e-12:
        return ZERO
    angle = 2.0 * math.atan2(half, w)
    if angle > math.pi:
        angle -= 2.0 * math.pi
    return (x * angle / half, y * angle / half, z * angle / half)


def quaternion(m: Sequence[Sequence[float]]) -> Quadruple:
    """Return the unit quaternion (x, y, z, w) of a rotation matrix; not a number where that has one."""
    (a, b, c), (d, e, f), (g, h, i) = m
    squares = (1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i, 1.0 + a + e + i)
    largest = max(range(4), key=squares.__getitem__)
    rows = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    x, y, z, w = rows[largest]
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not length > 0.0:
        return (math.nan, math.nan, math.nan, math.nan)
    return (x / length, y / length, z / length, w / length)


def is_finite(numbers: Sequence[float]) -> bool:
    """Whether all of them are."""
    return all(map(math.isfinite, numbers))
