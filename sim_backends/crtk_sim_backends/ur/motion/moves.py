"""Moves to a point, and blends between them: movej, movel, movep, movec, optimove and servoc.

A move with a blend radius returns when the tool comes within that radius of its waypoint: the
program goes on, and finds the next move in the same control period. That move begins while the
rest of the one before, its *tail*, still runs: the tail slows down to the waypoint and the new move
speeds up from it, both at constant rates over the same time, and their ways are added. For two
lines of equal speed this is a parabola that touches both at the blend radius. Where no move follows
at once, the arm is left without a command and ramps down, as the robot's does.

The blends of the real controller are not published. These have their documented properties: the
path stays within the radius, speed is continuous, a move that is timed takes its time, `movep`
rounds corners on an arc at constant speed, and blends that would overlap skip the waypoint.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from math import dist, sqrt
from typing import Any, Final

from crtk_sim_backends.ur.messages import ErrorMessage, Message, ReportLevel
from crtk_sim_backends.ur.motion.blends import NOWHERE, Pace, Tail, added, exit_speed, pieces
from crtk_sim_backends.ur.motion.control import SLOWEST_SHARE, Motion, MotionControl
from crtk_sim_backends.ur.motion.kinematics import Floats, Transform, compose, to_pose
from crtk_sim_backends.ur.motion.limits import SINGULARITY
from crtk_sim_backends.ur.motion.paths import Arc, JointPath, Line, Path, Rounded, ToolPath, rounded
from crtk_sim_backends.ur.motion.profiles import TIME_TOLERANCE, Profile, ramps
from crtk_sim_backends.ur.urscript import Builtin, ScriptRuntimeError
from crtk_sim_backends.ur.urscript.arguments import LARGEST, positive

BLEND_ISSUE: Final = 171
SKIPPED: Final = {
    "movej": (4, "Overlapping Blends in a MoveJ, a Waypoint was skipped"),
    "movel": (11, "Overlapping Blends in a MoveL, a Waypoint was skipped"),
    "movep": (9, "A MoveP-Waypoint were skipped due to a blend."),
    "movec": (0, "A MoveC-Waypoint were skipped due to a blend."),
}
"""Argument of error code 171, and text, by the move that is skipped."""

ABORTABLE: Final = ("movej", "movel")
"""Moves that `abort` of interpreter mode stops (manual: "currently only movej and movel")."""

TOOL_ACCELERATION: Final = 10.0
JOINT_ACCELERATION: Final = 10.0
"""m/s^2 and rad/s^2 of the largest accelerations of `optimovel` and `optimovej`, and of what a move that is
given its time, or slowed down, has at most."""

_TRIALS = 12  # to find how far joints can follow in one period


class Moves:
    """The built-ins that move the arm to a point.

    Args:
        control: of the arm.
        post: sends a message to the clients.
    """

    def __init__(self, control: MotionControl, post: Callable[[Message], None]) -> None:
        self._control = control
        self._post = post
        self._plant = control.plant
        self._arm = control.arm
        self._kinematics = control.kinematics
        self._tail: Tail | None = None
        self._waypoint: Floats = ()
        self._waypoint_tick = -2
        self._abortable: Pace | None = None  # of the last move that `abort` stops
        self._aborted: Pace | None = None

    def builtins(self) -> Iterator[Builtin]:
        """Every built-in of this class."""
        for call in (
            self.movej,
            self.movel,
            self.movep,
            self.movec,
            self.optimovej,
            self.optimovel,
            self.servoc,
        ):
            yield Builtin(call.__name__, call, blocking=True)

    @property
    def waypoint(self) -> Floats | None:
        """Pose to which the running move goes (`get_target_waypoint`), None when none runs."""
        return self._waypoint if self._waypoint_tick >= self._control.tick - 1 else None

    def abort(self) -> None:
        """Stop the running `movej` or `movel`; with a blend radius, have its blend begin now.

        Without effect when none runs, and with a blend radius on one that still blends with the move
        before it. Source: script manual, "Interpreter Mode", `abort`.
        """
        self._aborted = self._abortable

    # Built-ins, with the names and defaults of the URScript manual.

    def movej(self, q: Any, a: float = 1.4, v: float = 1.05, t: float = 0, r: float = 0) -> Motion:
        """Move to `q`, rad (or to a pose), linear in joint space; `t` s overrides `a` and `v`."""
        a = positive("movej a", a)
        goal = yield from self._begin("movej", q, a, r)
        path = self._joint_path(_reached("movej", goal))
        v = positive("movej v", v)
        if path.length:
            # The leading axis moves with v; a slower joint slows the whole move down.
            v = min(v, path.fastest(self._arm.model.velocity))
        yield from self._go("movej", path, _pace("movej", v, a, t), r)

    def movel(
        self, pose: Any, a: float = 1.2, v: float = 0.25, t: float = 0, r: float = 0
    ) -> Motion:
        """Move to `pose` (or joint positions) on a straight line in tool space."""
        a = positive("movel a", a)
        goal = yield from self._begin("movel", pose, a, r)
        path = self._line(self._control.target("movel", pose), goal)
        yield from self._go("movel", path, _pace("movel", v, a, t), r)

    def movep(self, pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0) -> Motion:
        """Move to `pose` on a line, and around corners on an arc, with constant tool speed."""
        a = positive("movep a", a)
        goal = yield from self._begin("movep", pose, a, r)
        path = self._line(self._control.target("movep", pose), goal)
        yield from self._go("movep", path, _pace("movep", v, a, constant=True), r)

    def movec(
        self,
        pose_via: Any,
        pose_to: Any,
        a: float = 1.2,
        v: float = 0.25,
        r: float = 0,
        mode: int = 0,
    ) -> Motion:
        """Move on a circle through `pose_via` to `pose_to`.

        Only the position of `pose_via` counts. Mode 0 turns the tool to the orientation of
        `pose_to`, mode 1 keeps its orientation relative to the circle.
        """
        if mode not in (0, 1):
            raise ScriptRuntimeError(f"movec: mode must be 0 or 1, not {mode}")
        control = self._control
        a = positive("movec a", a)
        via = control.target("movec", pose_via)
        end = control.target("movec", pose_to)
        fixed = mode == 1
        goal = yield from self._begin("movec", None if fixed else pose_to, a, r)
        arc = Arc(self._origin_pose(), via, end, fixed)
        if fixed:
            self._set_waypoint(arc.at(1.0))
        path = ToolPath(arc, self._kinematics, self._plant.tool, None if fixed else goal)
        yield from self._go("movec", path, _pace("movec", v, a, constant=True), r)

    def optimovej(self, q: Any, a: float = 0.3, v: float = 0.3, r: float = 0) -> Motion:
        """Move to `q` with fractions `a` and `v` (0 to 1] of what the joints can do."""
        a, v = _fractions("optimovej", a, v)
        model = self._arm.model
        acceleration = a * JOINT_ACCELERATION
        goal = yield from self._begin("optimovej", q, acceleration, r)
        path = self._joint_path(_reached("optimovej", goal))
        speed = v * path.fastest(model.velocity) if path.length else v
        yield from self._go("movej", path, Pace(speed, acceleration), r)

    def optimovel(self, pose: Any, a: float = 0.3, v: float = 0.3, r: float = 0) -> Motion:
        """Move linearly to `pose` with fractions `a` and `v` of 10 m/s^2 and 1 m/s."""
        a, v = _fractions("optimovel", a, v)
        goal = yield from self._begin("optimovel", pose, TOOL_ACCELERATION * a, r)
        path = self._line(self._control.target("optimovel", pose), goal)
        yield from self._go("movel", path, Pace(v, TOOL_ACCELERATION * a), r)

    def servoc(self, pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0) -> Motion:
        """Servo to `pose` with constant tool speed, around corners on an arc."""
        a = positive("servoc a", a)
        goal = yield from self._begin("servoc", pose, a, r)
        path = self._line(self._control.target("servoc", pose), goal)
        yield from self._go("servoc", path, _pace("servoc", v, a, constant=True), r)

    # The beginning of a move.

    def _begin(
        self, name: str, goal: Any, deceleration: float, radius: float
    ) -> Generator[None, None, list[float] | None]:
        """Take the arm, at rest or out of a blend; returns the joint positions of `goal`.

        None when that is out of reach: a line leads towards it, and ends where joints cannot follow
        with a protective stop (tests of Universal_Robots_Client_Library).
        """
        if not isinstance(radius, (int, float)) or not 0.0 <= radius <= LARGEST:
            raise ScriptRuntimeError(f"{name} r: expected a blend radius, got {radius}")
        control = self._control
        control.claim()
        if self._tail is not None and self._tail.tick != control.tick:
            self._tail = None
        q = self._origin() if goal is None else control.goal(name, goal, self._origin())
        if q is None:
            self._set_waypoint(control.target(name, goal))
        else:
            self._set_waypoint(compose(self._kinematics.flange(q), self._plant.tool))
        if self._tail is None:
            for _ in control.halt(deceleration):
                self._waypoint_tick = control.tick
                yield
        return q

    def _set_waypoint(self, pose: Transform) -> None:
        self._waypoint = to_pose(pose)
        self._waypoint_tick = self._control.tick

    def _origin(self) -> list[float]:
        """Joint positions at which the next path begins."""
        return self._tail.waypoint if self._tail is not None else list(self._arm.plan_q)

    def _origin_pose(self) -> Transform:
        return compose(self._kinematics.flange(self._origin()), self._plant.tool)

    def _joint_path(self, goal: Floats) -> JointPath:
        return JointPath(self._origin(), goal, self._kinematics, self._plant.tool)

    def _line(self, target: Transform, goal: Floats | None) -> ToolPath:
        line = Line(self._origin_pose(), target)
        return ToolPath(line, self._kinematics, self._plant.tool, goal)

    # The way.

    def _go(self, name: str, path: Path, pace: Pace, radius: float) -> Motion:
        """Follow `path`; with a blend radius, to where the blend with the next move begins."""
        tail, self._tail = self._tail, None
        if path.length < NOWHERE:
            radius = 0.0
            if tail is None:
                yield from self._control.hold()
                return
        lead = path.near_start(tail.radius) if tail is not None else 0.0
        entry = path.near_end(radius) if radius > NOWHERE else 0.0
        if entry and lead + entry >= path.length:
            if name in SKIPPED:
                self._skip(name)
                self._tail = tail
                return
            entry = path.length - lead
        if tail is not None and pace.constant and tail.constant:
            around = self._around(tail, path)
            if around is not None:
                end = exit_speed(pace, entry)
                way = around.length - entry
                around_it = ramps(way, pace.speed, pace.acceleration, tail.speed, end)
                profile = Profile(around_it, tail.speed)
                yield from self._follow(around, profile, None, pace, radius if entry else 0.0)
                return
        if pace.seconds:
            pace = replace(pace, seconds=max(pace.seconds, self._least_seconds(path)))
        profile = Profile(pieces(path.length, pace, tail, lead, entry))
        yield from self._follow(path, profile, tail, pace, radius if entry else 0.0)

    def _least_seconds(self, path: Path) -> float:
        """Seconds that a move takes at least, in three equal parts: speeding up, going, slowing down."""
        model = self._arm.model
        if isinstance(path, JointPath):
            speed, acceleration = path.fastest(model.velocity), JOINT_ACCELERATION
        else:
            speed, acceleration = self._control.tool_speed, TOOL_ACCELERATION
        return max(1.5 * path.length / speed, sqrt(4.5 * path.length / acceleration))

    def _skip(self, name: str) -> None:
        argument, text = SKIPPED[name]
        self._post(
            ErrorMessage(BLEND_ISSUE, argument, ReportLevel.WARNING, f"Issue with blends: {text}")
        )

    def _around(self, tail: Tail, path: Path) -> ToolPath | None:
        """Way from the beginning of the blend around the corner, at constant speed."""
        before = tail.path
        if not isinstance(path, ToolPath) or not isinstance(before, ToolPath):
            return None
        shape = before.shape
        first = shape.line if isinstance(shape, Rounded) else shape
        if path.tool is not before.tool or not isinstance(first, Line):
            return None
        if not isinstance(path.shape, Line):
            return None
        corner = rounded(first, path.shape, before.length - tail.begin)
        if corner is None:
            return None
        return ToolPath(corner, self._kinematics, path.tool, path.goal)

    def _follow(
        self, path: Path, profile: Profile, tail: Tail | None, pace: Pace, radius: float
    ) -> Motion:
        """Move along `path`, to its end or to where the blend with `radius` begins."""
        arm = self._arm
        control = self._control
        alone = path if isinstance(path, JointPath) and tail is None else None
        elapsed, rates = 0.0, arm.plan_qd
        while True:
            control.claim()
            self._waypoint_tick = control.tick
            if pace.abortable:
                self._abortable = pace
            h = arm.dt * arm.scale
            found = self._farther(path, profile, tail, elapsed, rates)
            if found is None:
                yield from control.stop_protectively(SINGULARITY)
                return
            later, q = found
            slowed = later < elapsed + h - TIME_TOLERANCE
            elapsed = later
            distance, speed = profile.at(elapsed)
            arrived = not radius and elapsed >= profile.duration - TIME_TOLERANCE
            before = arm.plan_q
            if tail is not None and elapsed >= tail.duration:
                tail = None
            if alone is not None and not slowed:
                rates = alone.rates(speed)
            elif h > TIME_TOLERANCE:
                rates = [(x - y) / h for x, y in zip(q, before, strict=True)]
            arm.command(q, [0.0] * 6 if arrived else rates)
            yield
            if arrived:
                return
            if self._aborted is pace:
                self._aborted = None
                if radius and tail is None:
                    self._tail = self._early_tail(path, distance, speed, pace, radius)
                    if self._tail is not None:
                        return
                elif not radius and tail is not None:
                    yield from control.halt(pace.acceleration)
                    return
                elif not radius:
                    braked = profile.braked(elapsed, pace.acceleration)
                    profile = braked if braked.distance < path.length else profile
            if radius and elapsed + arm.dt * arm.scale > profile.duration:
                waypoint = path.joints(path.length, arm.plan_q)
                if waypoint is not None:
                    self._tail = Tail(
                        path,
                        distance,
                        speed,
                        radius,
                        pace.constant,
                        control.tick,
                        path.length,
                        waypoint,
                    )
                return

    def _farther(
        self, path: Path, profile: Profile, tail: Tail | None, elapsed: float, rates: Floats
    ) -> tuple[float, list[float]] | None:
        """Path time after this period, and joint positions then: as far as joints and tool get.

        `rates` are those of the period before. None where they hardly get on, as in a singularity.
        """
        arm = self._arm
        period = arm.dt * arm.scale
        share = 1.0
        for _ in range(_TRIALS):
            later = elapsed + share * period
            distance, _ = profile.at(later)
            behind = tail if tail is not None and later < tail.duration else None
            q = self._point(path, distance, behind, later)
            if q is None:
                return None
            excess = self._excess(q, period, rates)
            if excess <= 1.0:
                return later, q
            share *= max(0.1, 0.999 / excess)
            if share < SLOWEST_SHARE:
                return None
        return None

    def _excess(self, q: Floats, period: float, rates: Floats) -> float:
        """How many times faster joints or tool would be than they may, to be at `q` in `period` s.

        A joint also gets faster no sooner than it can.
        """
        if period < TIME_TOLERANCE:
            return 0.0
        arm, model = self._arm, self._arm.model
        gain = model.acceleration * period
        way = most = 0.0
        for before, after, speed, limit in zip(arm.plan_q, q, rates, model.velocity, strict=True):
            step = abs(after - before)
            way += step
            most = max(most, step / min(limit, abs(speed) + gain))
        # What the tool could move if all joints turned it at arm's length.
        if way * self._control.arm_length > self._control.tool_speed * period:
            here, there = (
                compose(self._kinematics.flange(joints), self._plant.tool)[9:]
                for joints in (arm.plan_q, q)
            )
            most = max(most, dist(here, there) / self._control.tool_speed)
        return most / period

    def _early_tail(
        self, path: Path, distance: float, speed: float, pace: Pace, radius: float
    ) -> Tail | None:
        """Tail of a move whose blend begins before its time; None where that cannot be."""
        end = distance + max(path.near_end(radius), speed * speed / pace.acceleration)
        waypoint = path.joints(end, self._arm.plan_q) if end < path.length else None
        if waypoint is None or speed <= 0.0:
            return None
        return Tail(path, distance, speed, radius, False, self._control.tick, end, waypoint)

    def _point(
        self, path: Path, distance: float, tail: Tail | None, elapsed: float
    ) -> list[float] | None:
        """Joint positions `distance` along `path`, with what is left of the move before."""
        near = self._arm.plan_q
        if tail is None:
            return path.joints(distance, near)
        behind = tail.at(elapsed)
        before = tail.path
        if isinstance(path, ToolPath) and isinstance(before, ToolPath) and path.tool is before.tool:
            corner = path.pose(0.0)
            return path.solve(added(before.pose(behind), corner, path.pose(distance)), near)
        a = before.joints(behind, near)
        b = path.joints(distance, near)
        if a is None or b is None:
            return None
        return [x + y - w for x, y, w in zip(a, b, tail.waypoint, strict=True)]


def _reached(name: str, goal: list[float] | None) -> list[float]:
    if goal is None:
        raise ScriptRuntimeError(f"{name}: Unable to find an inverse kinematics solution")
    return goal


def _pace(name: str, v: Any, a: float, t: Any = 0, constant: bool = False) -> Pace:
    seconds = positive(f"{name} t", t) if t else 0.0
    return Pace(positive(f"{name} v", v), a, seconds, constant, name in ABORTABLE)


def _fractions(name: str, a: float, v: float) -> tuple[float, float]:
    if positive(f"{name} a", a) > 1.0 or positive(f"{name} v", v) > 1.0:
        raise ScriptRuntimeError(f"{name}: a and v are fractions from 0 to 1")
    return a, v
