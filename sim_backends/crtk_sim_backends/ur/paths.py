"""Where a move leads, and how far along it the arm is: profiles over time, lines and arcs."""

from __future__ import annotations

from math import atan2, cos, pi, sin, sqrt
from typing import Any

from crtk_sim_backends.ur.kinematics import (
    Floats,
    Transform,
    compose,
    cross,
    invert,
    norm,
    rotation_matrix,
    rotation_vector,
)
from crtk_sim_backends.ur.urscript import ScriptRuntimeError

ROTATION_RADIUS = 0.2  # m: a rotation counts as the path of a point at this distance
TIME_TOLERANCE = 1e-9  # s


class Trapezoid:
    """Distance over time with constant acceleration, constant speed, constant deceleration."""

    def __init__(self, distance: float, speed: float, acceleration: float) -> None:
        self.distance = distance
        self.acceleration = acceleration
        self.speed = min(speed, sqrt(distance * acceleration))
        self._ramp = self.speed / acceleration
        self.duration = distance / self.speed + self._ramp if distance > 0.0 else 0.0

    @classmethod
    def timed(cls, distance: float, duration: float) -> Trapezoid:
        """Profile that takes exactly `duration`, s, in three equal parts."""
        speed = 1.5 * distance / duration
        return cls(distance, speed, 3.0 * speed / duration)

    def at(self, t: float) -> tuple[float, float]:
        """Distance covered and speed after `t` seconds."""
        if t >= self.duration - TIME_TOLERANCE:
            return self.distance, 0.0
        if t < self._ramp:
            return 0.5 * self.acceleration * t * t, self.acceleration * t
        left = self.duration - t
        if left < self._ramp:
            return (
                self.distance - 0.5 * self.acceleration * left * left,
                self.acceleration * left,
            )
        return self.speed * (t - 0.5 * self._ramp), self.speed


class Line:
    """Straight path in tool space from `start` to `end`, with a rotation about one axis."""

    def __init__(self, start: Transform, end: Transform) -> None:
        self._start = start
        relative = compose(invert(start), end)
        self._shift = relative[9:]
        self._turn = rotation_vector(relative)
        self.length = max(norm(self._shift), norm(self._turn) * ROTATION_RADIUS)

    def at(self, fraction: float) -> Transform:
        """Transform after `fraction` of the path."""
        rx, ry, rz = self._turn
        x, y, z = self._shift
        step: Any = (
            *rotation_matrix(rx * fraction, ry * fraction, rz * fraction),
            x * fraction,
            y * fraction,
            z * fraction,
        )
        return compose(self._start, step)


class Arc:
    """Circular path from `start` through the position of `via` to `end`.

    With `fixed` orientation the tool keeps its angle to the tangent, else it turns from the
    orientation of `start` to that of `end`.
    """

    def __init__(self, start: Transform, via: Transform, end: Transform, fixed: bool) -> None:
        self._line = Line(start, end)
        self._start = start
        self._fixed = fixed
        p0, p1, p2 = start[9:], via[9:], end[9:]
        u = [b - a for a, b in zip(p0, p1, strict=True)]
        v = [b - a for a, b in zip(p0, p2, strict=True)]
        normal = cross(u, v)
        size = norm(normal)
        if size < 1e-12:
            raise ScriptRuntimeError("movec: the three positions do not lie on a circle")
        uu = sum(x * x for x in u)
        vv = sum(x * x for x in v)
        weighted = [uu * b - vv * a for a, b in zip(u, v, strict=True)]
        to_centre = [x / (2 * size * size) for x in cross(weighted, normal)]
        self._centre = [a + b for a, b in zip(p0, to_centre, strict=True)]
        self._axis = [x / size for x in normal]
        self._radius_x = [-x for x in to_centre]
        self._radius_y = cross(self._axis, self._radius_x)
        self._radius = norm(to_centre)
        self._angle = self._angle_of(p2)
        self.length = max(self._radius * self._angle, self._line.length)

    def _angle_of(self, point: Floats) -> float:
        arm = [p - c for p, c in zip(point, self._centre, strict=True)]
        x = sum(a * b for a, b in zip(arm, self._radius_x, strict=True))
        y = sum(a * b for a, b in zip(arm, self._radius_y, strict=True))
        return atan2(y, x) % (2 * pi)

    def at(self, fraction: float) -> Transform:
        """Transform after `fraction` of the path."""
        angle = self._angle * fraction
        c = cos(angle)
        s = sin(angle)
        position = [
            m + c * x + s * y
            for m, x, y in zip(self._centre, self._radius_x, self._radius_y, strict=True)
        ]
        rotation: Any
        if self._fixed:
            x, y, z = (a * angle for a in self._axis)
            turn: Any = (*rotation_matrix(x, y, z), 0.0, 0.0, 0.0)
            rotation = compose(turn, self._start)[:9]
        else:
            rotation = self._line.at(fraction)[:9]
        return (*rotation, *position)
