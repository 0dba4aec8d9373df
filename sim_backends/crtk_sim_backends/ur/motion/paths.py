"""Paths of moves: shapes in tool space, and ways of the arm along them or through joint space."""

from __future__ import annotations

from math import acos, atan2, cos, pi, sin, tan
from typing import Any, Protocol, TypeAlias

from crtk_sim_backends.ur.motion.kinematics import (
    Floats,
    Kinematics,
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
_CORNER = (0.01, pi - 0.1)  # rad: turns that an arc can round; others are nearly none, or reversals
_SAMPLES = 8  # of a way, to see where it leaves a radius
_BISECTIONS = 10


class Line:
    """Straight path in tool space from `start` to `end`, with a rotation about one axis."""

    def __init__(self, start: Transform, end: Transform) -> None:
        self.start = start
        self.end = end
        relative = compose(invert(start), end)
        self._shift = relative[9:]
        self._turn = rotation_vector(relative)
        self.length = max(norm(self._shift), norm(self._turn) * ROTATION_RADIUS)

    @property
    def direction(self) -> list[float] | None:
        """Unit vector along the line; None where the rotation is longer than the way."""
        way = [b - a for a, b in zip(self.start[9:], self.end[9:], strict=True)]
        if norm(way) < self.length - 1e-9 or self.length == 0.0:
            return None
        return [x / self.length for x in way]

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
        return compose(self.start, step)


class Arc:
    """Circular path from `start` through the position of `via` to `end`.

    With `fixed` orientation the tool keeps its angle to the tangent, and only the position of `end`
    counts; else it turns from the orientation of `start` to that of `end`.
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
        length = self._radius * self._angle
        self.length = length if fixed else max(length, self._line.length)

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


class Rounded:
    """Way around the corner between two lines: an arc that touches both, then the second line."""

    def __init__(self, arc: Arc, line: Line, skipped: float) -> None:
        self._arc = arc
        self.line = line
        self._skipped = skipped  # m of the line, along which the arc goes instead
        self.length = arc.length + line.length - skipped

    def at(self, fraction: float) -> Transform:
        """Transform after `fraction` of the path."""
        beyond = fraction * self.length - self._arc.length
        if beyond < 0.0:
            return self._arc.at(1.0 + beyond / self._arc.length)
        return self.line.at(min(1.0, (self._skipped + beyond) / self.line.length))


def rounded(first: Line, second: Line, before: float) -> Rounded | None:
    """Round the corner from `before`, m, ahead of the end of `first`; None where no arc can."""
    a, b = first.direction, second.direction
    if a is None or b is None or before >= second.length:
        return None
    turn = acos(max(-1.0, min(1.0, sum(x * y for x, y in zip(a, b, strict=True)))))
    if not _CORNER[0] < turn < _CORNER[1]:
        return None
    radius = before / tan(turn / 2)
    inward = [y - x for x, y in zip(a, b, strict=True)]
    offset = radius * (1.0 / cos(turn / 2) - 1.0) / norm(inward)
    corner = second.start[9:]
    middle: Any = (
        *second.start[:9],
        *(c + offset * x for c, x in zip(corner, inward, strict=True)),
    )
    start = first.at(1.0 - before / first.length)
    arc = Arc(start, middle, second.at(before / second.length), fixed=False)
    return Rounded(arc, second, before)


class Shape(Protocol):
    """Path of the tool; `length` in m."""

    length: float

    def at(self, fraction: float) -> Transform:
        """Transform after `fraction` of the path."""
        ...


class JointPath:
    """Straight path in joint space; its length is the way of the joint that turns farthest, rad."""

    def __init__(
        self, start: Floats, goal: Floats, kinematics: Kinematics, tool: Transform
    ) -> None:
        self._start = start
        self._goal = list(goal)
        self._delta = [b - a for a, b in zip(start, goal, strict=True)]
        self._kinematics = kinematics
        self.tool = tool
        self.length = max(map(abs, self._delta))

    def joints(self, distance: float, near: Floats) -> list[float]:
        """Joint positions after `distance`."""
        if distance >= self.length:
            return list(self._goal)
        fraction = distance / self.length
        return [a + d * fraction for a, d in zip(self._start, self._delta, strict=True)]

    def rates(self, speed: float) -> list[float]:
        """Joint rates at a speed along the path."""
        return [d * speed / self.length for d in self._delta]

    def pose(self, distance: float) -> Transform:
        """Transform of the tool after `distance`."""
        return compose(self._kinematics.flange(self.joints(distance, self._start)), self.tool)

    def fastest(self, limits: Floats) -> float:
        """Speed along the path at which the first joint reaches its limit."""
        return min(
            limit * self.length / abs(d) for limit, d in zip(limits, self._delta, strict=True) if d
        )

    def near_start(self, radius: float) -> float:
        """Longest way from the start that stays within `radius`, m."""
        return self._within(radius, 0.0, 1.0)

    def near_end(self, radius: float) -> float:
        """Longest way before the end that is within `radius`, m."""
        return self._within(radius, self.length, -1.0)

    def _within(self, radius: float, origin: float, sign: float) -> float:
        centre = self.pose(origin)
        inside = 0.0
        for i in range(1, _SAMPLES + 1):
            outside = self.length * i / _SAMPLES
            if _apart(centre, self.pose(origin + sign * outside)) > radius:
                break
            inside = outside
        else:
            return self.length
        for _ in range(_BISECTIONS):
            middle = 0.5 * (inside + outside)
            if _apart(centre, self.pose(origin + sign * middle)) > radius:
                outside = middle
            else:
                inside = middle
        return inside


class ToolPath:
    """Path of a shape in tool space, m; rotations count as in `paths.ROTATION_RADIUS`."""

    def __init__(
        self, shape: Shape, kinematics: Kinematics, tool: Transform, goal: Floats | None = None
    ) -> None:
        self.shape = shape
        self.tool = tool
        self.length = shape.length
        self._kinematics = kinematics
        self.goal = goal

    def joints(self, distance: float, near: Floats) -> list[float] | None:
        """Joint positions after `distance` in the branch of `near`, None when out of reach."""
        q = self.solve(self.pose(distance), near)
        goal = self.goal
        if q is None or goal is None or distance < self.length:
            return q
        # What was given as joint positions is met exactly.
        same = max([abs(x - y) for x, y in zip(q, goal, strict=True)]) < 1e-6
        return list(goal) if same else q

    def pose(self, distance: float) -> Transform:
        """Transform of the tool after `distance`."""
        return self.shape.at(distance / self.length if self.length else 1.0)

    def solve(self, pose: Transform, near: Floats) -> list[float] | None:
        """Joint positions that bring the tool of this path to `pose`."""
        return self._kinematics.follow(pose, near, self.tool)

    def near_start(self, radius: float) -> float:
        """Longest way from the start that stays within `radius`, m."""
        return min(radius, self.length)

    def near_end(self, radius: float) -> float:
        """Longest way before the end that is within `radius`, m."""
        return min(radius, self.length)


Path: TypeAlias = JointPath | ToolPath


def _apart(a: Transform, b: Transform) -> float:
    """How far the tool is from one transform in another, m; rotations count as in `paths`."""
    relative = compose(invert(a), b)
    return max(norm(relative[9:]), norm(rotation_vector(relative)) * ROTATION_RADIUS)
