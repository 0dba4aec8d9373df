"""The built-ins that move the arm, as generators: one step per control period.

Every step claims the arm. Two threads that command it in the same period stop the program, as on
the robot; a thread that ends or is killed lets go of it at once.

Blending is not simulated: a blend radius `r` is accepted and the arm stops at every waypoint.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

from crtk_sim_backends.ur.arguments import positive, six
from crtk_sim_backends.ur.arm import approach
from crtk_sim_backends.ur.kinematics import (
    Floats,
    Transform,
    compose,
    joint_rates,
    multiply,
    norm,
    to_pose,
    to_transform,
)
from crtk_sim_backends.ur.paths import TIME_TOLERANCE, Arc, Line, Trapezoid
from crtk_sim_backends.ur.urscript import Builtin, Pose, ScriptRuntimeError

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller

Motion: TypeAlias = Generator[None, None, None]

LOOKAHEAD_RANGE = (0.03, 0.2)  # s
GAIN_RANGE = (100.0, 2000.0)


class MotionLibrary:
    """The motion built-ins of one controller."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._arm = controller.arm
        self._kinematics = controller.kinematics
        self._claimed_tick = -2
        self._owner: object = None

    def builtins(self) -> Iterator[Builtin]:
        """Every motion built-in."""
        for call in (
            self.movej,
            self.movel,
            self.movep,
            self.movec,
            self.optimovej,
            self.optimovel,
            self.servoj,
            self.servoc,
            self.speedj,
            self.speedl,
            self.stopj,
            self.stopl,
            self.direct_torque,
        ):
            yield Builtin(call.__name__, call, blocking=True)

    def release(self, owner: object) -> None:
        """Let another thread command the arm in this period, because `owner` ended."""
        if self._owner == owner and self._claimed_tick == self._controller.tick_count:
            self._claimed_tick -= 1

    # Built-ins, with the names and defaults of the URScript manual.

    def movej(self, q: Any, a: float = 1.4, v: float = 1.05, t: float = 0, r: float = 0) -> Motion:
        """Move to `q`, rad (or to a pose), linear in joint space; `t` s overrides `a` and `v`."""
        self._claim()
        goal = self._joint_goal("movej", q)
        self._controller.waypoint = self._pose_at(goal)
        yield from self._halt_at(positive("movej a", a))
        start = list(self._arm.plan_q)
        delta = [b - x for x, b in zip(start, goal, strict=True)]
        distance = max(map(abs, delta))
        if distance == 0.0:
            yield from self._dwell()
            return
        # The leading axis moves with v; a slower joint slows the whole move down.
        fastest = min(
            limit * distance / abs(d)
            for limit, d in zip(self._arm.model.velocity, delta, strict=True)
            if d
        )
        if t:
            profile = Trapezoid.timed(distance, positive("movej t", t))
        else:
            profile = Trapezoid(
                distance, min(positive("movej v", v), fastest), positive("movej a", a)
            )

        def put(travelled: float, speed: float) -> None:
            if travelled == distance:
                self._arm.command(list(goal), [0.0] * 6)
                return
            fraction = travelled / distance
            rate = speed / distance
            self._arm.command(
                [x + d * fraction for x, d in zip(start, delta, strict=True)],
                [d * rate for d in delta],
            )

        yield from self._follow(profile, put)

    def movel(
        self, pose: Any, a: float = 1.2, v: float = 0.25, t: float = 0, r: float = 0
    ) -> Motion:
        """Move to `pose` (or joint positions) on a straight line in tool space."""
        self._claim()
        goal, q = self._tool_goal("movel", pose)
        self._controller.waypoint = to_pose(goal)
        yield from self._halt_at(positive("movel a", a))
        yield from self._travel("movel", Line(self._tool(), goal), q, a, v, t)

    def movep(self, pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0) -> Motion:
        """Process move; without blending it is a `movel`."""
        yield from self.movel(pose, a, v)

    def movec(
        self,
        pose_via: Any,
        pose_to: Any,
        a: float = 1.2,
        v: float = 0.25,
        r: float = 0,
        mode: int = 0,
    ) -> Motion:
        """Move on a circle through `pose_via` to `pose_to`; mode 1 keeps the orientation fixed."""
        self._claim()
        via, _ = self._tool_goal("movec", pose_via)
        goal, q = self._tool_goal("movec", pose_to)
        self._controller.waypoint = to_pose(goal)
        yield from self._halt_at(positive("movec a", a))
        path = Arc(self._tool(), via, goal, fixed=mode == 1)
        yield from self._travel("movec", path, None if mode == 1 else q, a, v, 0)

    def optimovej(self, q: Any, a: float = 0.3, v: float = 0.3, r: float = 0) -> Motion:
        """Move to `q` with fractions `a` and `v` (0 to 1] of what the joints can do."""
        a, v = self._fractions("optimovej", a, v)
        model = self._arm.model
        yield from self.movej(q, a * model.acceleration / 4, v * min(model.velocity))

    def optimovel(self, pose: Any, a: float = 0.3, v: float = 0.3, r: float = 0) -> Motion:
        """Move linearly to `pose` with fractions `a` and `v` of 10 m/s^2 and 1 m/s."""
        a, v = self._fractions("optimovel", a, v)
        yield from self.movel(pose, a * 10.0, v)

    def servoj(
        self,
        q: Any,
        a: float = 0,
        v: float = 0,
        t: float = 0.002,
        lookahead_time: float = 0.1,
        gain: float = 300,
    ) -> Motion:
        """Follow `q`, rad, for `t` s through a filter; `a` and `v` are not used (manual)."""
        goal = six("servoj", q)
        lookahead = max(LOOKAHEAD_RANGE[0], min(LOOKAHEAD_RANGE[1], lookahead_time))
        gain = max(GAIN_RANGE[0], min(GAIN_RANGE[1], gain))
        for _ in range(self._ticks(t)):
            self._claim()
            self._arm.servo(goal, lookahead, gain)
            yield

    def servoc(self, pose: Any, a: float = 1.2, v: float = 0.25, r: float = 0) -> Motion:
        """Servo to `pose` with constant tool speed; without blending it is a `movel`."""
        yield from self.movel(pose, a, v)

    def speedj(self, qd: Any, a: float = 1.4, t: float | None = None) -> Motion:
        """Accelerate to joint speeds `qd`, rad/s; return after `t` s, or once they are reached."""
        goal = six("speedj", qd)
        acceleration = positive("speedj a", a)
        arm = self._arm
        ticks = self._ticks(t) if t is not None else 0
        while True:
            self._claim()
            arm.command_velocity(approach(arm.plan_qd, goal, acceleration * arm.dt * arm.scale))
            yield
            ticks -= 1
            if ticks == 0 or (t is None and arm.plan_qd == goal):
                return

    def speedl(
        self,
        xd: Any,
        a: float = 1.2,
        t: float | None = None,
        aRot: Any = None,  # noqa: N803
    ) -> Motion:
        """Accelerate to tool speed `xd` (m/s and rad/s, base axes); return as `speedj` does."""
        goal = six("speedl", xd)
        acceleration = positive("speedl a", a)
        turn = positive("speedl aRot", aRot) if isinstance(aRot, (int, float)) else acceleration
        arm = self._arm
        ticks = self._ticks(t) if t is not None else 0
        while True:
            self._claim()
            matrix = self._kinematics.jacobian(arm.plan_q, self._controller.tool)
            twist = multiply(matrix, arm.plan_qd)
            h = arm.dt * arm.scale
            reached = (
                *_approach_vector(twist[:3], goal[:3], acceleration * h),
                *_approach_vector(twist[3:], goal[3:], turn * h),
            )
            qd = joint_rates(matrix, reached)
            if qd is None:
                yield from self._stopped_protectively(154)
                return
            arm.command_velocity(qd)
            yield
            ticks -= 1
            if ticks == 0 or (t is None and list(reached) == goal):
                return

    def stopj(self, a: float = 2.0) -> Motion:
        """Slow all joints down to rest, the fastest with `a`, rad/s^2."""
        yield from self._halt_at(positive("stopj a", a), at_least_once=True)

    def stopl(self, a: float = 10.0, aRot: Any = None) -> Motion:  # noqa: N803
        """Slow the tool down to rest on its straight line, with `a`, m/s^2 (`aRot`, rad/s^2).

        In a singularity, where that is impossible, the joints slow down alike.
        """
        linear = positive("stopl a", a)
        turn = positive("stopl aRot", aRot) if isinstance(aRot, (int, float)) else linear
        arm = self._arm
        if not any(arm.plan_qd):
            yield from self._dwell()
            return
        matrix = self._kinematics.jacobian(arm.plan_q, self._controller.tool)
        twist = multiply(matrix, arm.plan_qd)
        # Both come to rest together, so that the path stays what it was.
        seconds = max(norm(twist[:3]) / linear, norm(twist[3:]) / turn)
        left = seconds
        while True:
            self._claim()
            left -= arm.dt * arm.scale
            matrix = self._kinematics.jacobian(arm.plan_q, self._controller.tool)
            qd = (
                joint_rates(matrix, [v * left / seconds for v in twist])
                if left > 0.0
                else [0.0] * 6
            )
            if qd is None:
                yield from self._halt_at(linear)
                return
            arm.command_velocity(qd)
            yield
            if left <= 0.0:
                return

    def direct_torque(
        self,
        torque: Any,
        friction_comp: bool = True,
        viscous_scale: Any = None,
        coulomb_scale: Any = None,
    ) -> Motion:
        """Apply joint torques, N.m, on top of gravity compensation, for one period."""
        load = six("direct_torque", torque)
        arm = self._arm
        self._claim()
        inertia = self._controller.mass_matrix(arm.plan_q)
        friction = 0.02 if friction_comp else 0.05
        qd = []
        for i in range(6):
            damping = friction * arm.model.torque[i] * arm.plan_qd[i]
            acceleration = (load[i] - damping) / inertia[i][i]
            qd.append(arm.plan_qd[i] + acceleration * arm.dt)
        arm.command_velocity(qd)
        yield

    # Parts.

    def _claim(self) -> None:
        """Take the arm for this period. Raises ScriptRuntimeError when another thread has it."""
        controller = self._controller
        caller = controller.player.caller()
        if caller[0].program.kind == "sec":
            raise ScriptRuntimeError("A secondary program must not move the robot")
        if not self._arm.enabled:
            raise ScriptRuntimeError("The robot is not running: power it on and release the brakes")
        tick = controller.tick_count
        if self._claimed_tick == tick:
            if self._owner != caller:
                raise ScriptRuntimeError("Another thread is already controlling the robot")
        elif self._claimed_tick < tick - 1:
            self._arm.rebase()
        self._claimed_tick = tick
        self._owner = caller

    def _ticks(self, seconds: float) -> int:
        return max(1, round(seconds / self._arm.dt))

    def _tool(self) -> Transform:
        flange = self._kinematics.flange(self._arm.plan_q)
        return compose(flange, self._controller.tool)

    def _pose_at(self, q: Floats) -> Floats:
        return self._kinematics.forward(q, self._controller.tool)

    def _joint_goal(self, name: str, value: Any) -> list[float]:
        """Joint positions of an argument that is a joint list or a pose."""
        return self._tool_goal(name, value)[1] if isinstance(value, Pose) else six(name, value)

    def _tool_goal(self, name: str, value: Any) -> tuple[Transform, list[float]]:
        """Transform of an argument that is a pose or a joint list, and its joint positions."""
        numbers = six(name, value)
        tool = self._controller.tool
        if not isinstance(value, Pose):
            return compose(self._kinematics.flange(numbers), tool), numbers
        goal = to_transform(numbers)
        q = self._kinematics.inverse(goal, self._arm.plan_q, tool)
        if q is None:
            raise ScriptRuntimeError(f"{name}: Unable to find an inverse kinematics solution")
        return goal, q

    def _fractions(self, name: str, a: float, v: float) -> tuple[float, float]:
        if positive(f"{name} a", a) > 1.0 or positive(f"{name} v", v) > 1.0:
            raise ScriptRuntimeError(f"{name}: a and v are fractions from 0 to 1")
        return a, v

    def _dwell(self) -> Motion:
        """Hold the arm for one period."""
        self._claim()
        self._arm.command(list(self._arm.plan_q), [0.0] * 6)
        yield

    def _halt_at(self, deceleration: float, at_least_once: bool = False) -> Motion:
        """Bring the arm to rest; takes no time when it rests, unless `at_least_once`."""
        arm = self._arm
        if at_least_once and not any(arm.plan_qd):
            yield from self._dwell()
        while any(arm.plan_qd):
            self._claim()
            step = deceleration * arm.dt * arm.scale
            arm.command_velocity(approach(arm.plan_qd, (0.0,) * 6, step))
            yield

    def _follow(self, profile: Trapezoid, put: Callable[[float, float], None]) -> Motion:
        """Call `put(distance, speed)` in every period until the profile ends."""
        t = 0.0
        while t < profile.duration - TIME_TOLERANCE:
            self._claim()
            t += self._arm.dt * self._arm.scale
            put(*profile.at(t))
            yield

    def _travel(
        self,
        name: str,
        path: Line | Arc,
        end: list[float] | None,
        a: float,
        v: float,
        t: float,
    ) -> Motion:
        """Move the tool along `path`; at its end the joints are exactly at `end` if given."""
        if path.length < 1e-9:
            yield from self._dwell()
            return
        if t:
            profile = Trapezoid.timed(path.length, positive(f"{name} t", t))
        else:
            profile = Trapezoid(path.length, positive(f"{name} v", v), positive(f"{name} a", a))
        arm = self._arm
        travelled = 0.0
        while travelled < profile.duration - TIME_TOLERANCE:
            self._claim()
            h = arm.dt * arm.scale
            travelled += h
            distance, _ = profile.at(travelled)
            before = arm.plan_q
            goal = path.at(distance / path.length)
            q = self._kinematics.follow(goal, before, self._controller.tool)
            if q is None or self._leaps(before, q):
                yield from self._stopped_protectively(154)
                return
            if travelled >= profile.duration - TIME_TOLERANCE:
                arrived = end is not None and max(abs(x - y) for x, y in zip(q, end, strict=True))
                final = end if end is not None and arrived < 1e-6 else q
                arm.command(list(final), [0.0] * 6)
            elif h > 0.0:
                arm.command(q, [(x - y) / h for x, y in zip(q, before, strict=True)])
            else:
                arm.command(q, arm.plan_qd)
            yield

    def _leaps(self, before: Floats, after: Floats) -> bool:
        """Whether a joint would turn faster than it can, as near a singularity."""
        dt = self._arm.dt
        return any(
            abs(y - x) > limit * dt
            for x, y, limit in zip(before, after, self._arm.model.velocity, strict=True)
        )

    def _stopped_protectively(self, code: int) -> Motion:
        """Stop protectively and wait for the end of the program."""
        self._controller.protective_stop(code)
        while True:
            yield


def _approach_vector(current: Floats, goal: Floats, step: float) -> list[float]:
    """Move a 3-vector towards `goal` on a straight line by at most `step`."""
    delta = [g - c for c, g in zip(current, goal, strict=True)]
    distance = norm(delta)
    if distance <= step:
        return list(goal)
    return [c + d * step / distance for c, d in zip(current, delta, strict=True)]
