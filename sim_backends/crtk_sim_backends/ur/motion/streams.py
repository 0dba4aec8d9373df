"""The built-ins that stream motions, as generators: one step per control period."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import inf, isfinite, tanh
from typing import Any, Final

from crtk_sim_backends.ur.motion.arm import approach
from crtk_sim_backends.ur.motion.control import (
    SLOWEST_SHARE,
    Motion,
    MotionControl,
)
from crtk_sim_backends.ur.motion.dynamics import solve
from crtk_sim_backends.ur.motion.kinematics import (
    Floats,
    joint_rates,
    multiply,
    norm,
    transpose_multiply,
)
from crtk_sim_backends.ur.motion.limits import SINGULARITY
from crtk_sim_backends.ur.motion.profiles import TIME_TOLERANCE
from crtk_sim_backends.ur.urscript import Builtin, ScriptRuntimeError
from crtk_sim_backends.ur.urscript.arguments import positive, six

LOOKAHEAD_RANGE = (0.03, 0.2)  # s
GAIN_RANGE = (100.0, 2000.0)

VISCOUS: Final = 0.05  # friction for each rad/s, of a joint's torque limit
COULOMB: Final = 0.02  # friction of a joint that moves, of its torque limit
STICKING: Final = 0.01  # rad/s, up to which that friction grows
VISCOUS_SCALE: Final = (0.9, 0.9, 0.8, 0.9, 0.9, 0.9)
COULOMB_SCALE: Final = (0.8, 0.8, 0.7, 0.8, 0.8, 0.8)
"""How much of the friction `direct_torque` compensates by default (URScript manual 5.25)."""


class Streams:
    """The built-ins that follow a stream of set points, and those that stop."""

    def __init__(self, control: MotionControl) -> None:
        self._control = control
        self._plant = control.plant
        self._arm = control.arm
        self._kinematics = control.kinematics
        self._planned: list[float] = []  # joint speeds of the last speedj or speedl
        self._slowed: list[float] = []  # what they were slowed down to

    def builtins(self) -> Iterator[Builtin]:
        """Every built-in of this class."""
        for call in (
            self.servoj,
            self.speedj,
            self.speedl,
            self.stopj,
            self.stopl,
            self.direct_torque,
        ):
            yield Builtin(call.__name__, call, blocking=True)

    # Built-ins, with the names and defaults of the URScript manual.

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
            self._control.claim()
            self._arm.servo(goal, lookahead, gain)
            yield

    def speedj(self, qd: Any, a: float = 1.4, t: float | None = None) -> Motion:
        """Accelerate to joint speeds `qd`, rad/s; return after `t` s, or once they are reached.

        As everything that moves the arm, `t` is longer the lower the speed slider is (UR's external
        control program counts the time of its splines by it).
        """
        goal = six("speedj", qd)
        acceleration = _acceleration("speedj a", a)

        def faster(before: list[float], seconds: float) -> list[float]:
            return approach(before, goal, acceleration * seconds)

        yield from self._speed(faster, lambda qd: qd == goal, t)

    def speedl(
        self,
        xd: Any,
        a: float = 1.2,
        t: float | None = None,
        aRot: Any = None,  # noqa: N803
    ) -> Motion:
        """Accelerate to tool speed `xd` (m/s and rad/s, base axes); return as `speedj` does."""
        goal = six("speedl", xd)
        acceleration = _acceleration("speedl a", a)
        turn = (
            _acceleration("speedl aRot", aRot) if isinstance(aRot, (int, float)) else acceleration
        )
        arm = self._arm
        reached: list[float] = []

        def faster(before: list[float], seconds: float) -> list[float] | None:
            matrix = self._kinematics.jacobian(arm.plan_q, self._plant.tool)
            twist = multiply(matrix, before)
            reached[:] = (
                *_approach_vector(twist[:3], goal[:3], acceleration * seconds),
                *_approach_vector(twist[3:], goal[3:], turn * seconds),
            )
            return joint_rates(matrix, reached)

        yield from self._speed(faster, lambda qd: reached == goal, t)

    def _speed(
        self,
        faster: Callable[[list[float], float], list[float] | None],
        reached: Callable[[list[float]], bool],
        t: float | None,
    ) -> Motion:
        """Move with the joint speeds of `faster`, which gets those before and the seconds of path time.

        Where a joint or the tool would be too fast, path time passes more slowly. A call that ends
        within a period leaves the rest of it to the next.
        """
        arm, control = self._arm, self._control
        seconds = t if t is not None and t > 0.0 else inf
        while True:
            control.claim()
            left = arm.time_left
            # As fast as it was planned, where it was slowed down.
            before = arm.commanded_qd
            before = self._planned if before == self._slowed else before
            step = min(seconds, left)
            qd = faster(before, step)
            share = 0.0 if qd is None else control.share(qd)
            if qd is not None and share < 1.0:
                step = min(seconds, left * share)
                qd = faster(before, step)
                share = 0.0 if qd is None else min(share, control.share(qd))
            if qd is None or share < SLOWEST_SHARE:
                yield from control.stop_protectively(SINGULARITY)
                return
            self._planned, self._slowed = qd, [v * share for v in qd]
            seconds -= step
            if seconds < TIME_TOLERANCE < left - step / share:
                arm.command_velocity(self._slowed, step / share)
                return
            arm.command_velocity(self._slowed)
            yield
            if seconds < TIME_TOLERANCE or (t is None and reached(qd)) or t == 0.0:
                return

    def stopj(self, a: float = 2.0) -> Motion:
        """Slow all joints down to rest, the fastest with `a`, rad/s^2."""
        deceleration = positive("stopj a", a)
        if not any(self._arm.plan_qd):
            yield from self._control.hold()
        yield from self._control.halt(deceleration)

    def stopl(self, a: float = 10.0, aRot: Any = None) -> Motion:  # noqa: N803
        """Slow the tool down to rest on its straight line, with `a`, m/s^2 (`aRot`, rad/s^2).

        In a singularity, where that is impossible, the joints slow down alike.
        """
        linear = positive("stopl a", a)
        turn = positive("stopl aRot", aRot) if isinstance(aRot, (int, float)) else linear
        arm = self._arm
        if not any(arm.plan_qd):
            yield from self._control.hold()
            yield from self._control.halt(linear)
            return
        matrix = self._kinematics.jacobian(arm.plan_q, self._plant.tool)
        twist = multiply(matrix, arm.plan_qd)
        # Both come to rest together, so that the path stays what it was.
        seconds = max(norm(twist[:3]) / linear, norm(twist[3:]) / turn)
        left = seconds
        while True:
            self._control.claim()
            left -= arm.dt * arm.scale
            matrix = self._kinematics.jacobian(arm.plan_q, self._plant.tool)
            qd = (
                joint_rates(matrix, [v * left / seconds for v in twist])
                if left > 0.0
                else [0.0] * 6
            )
            if qd is None:
                yield from self._control.halt(linear)
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
        """Apply joint torques, N.m, on top of gravity compensation, for one period.

        The scales [0, 1] tell how much of the friction is compensated; `friction_comp` False:
        nothing. Speed slider and pause do not slow this down.
        """
        control = self._control
        plant = self._plant
        arm = self._arm
        load = six("direct_torque", torque)
        full = 1.0 if friction_comp else 0.0
        viscous = _scales("viscous_scale", viscous_scale, VISCOUS_SCALE, full)
        coulomb = _scales("coulomb_scale", coulomb_scale, COULOMB_SCALE, full)
        control.claim()
        if arm.scale <= 0.0:
            yield from control.hold()
            return
        q = arm.plan_q
        qd = [v * arm.scale for v in arm.plan_qd]
        limits = arm.model.torque
        drag = [
            limit * ((1.0 - b) * VISCOUS * v + (1.0 - c) * COULOMB * tanh(v / STICKING))
            for limit, v, b, c in zip(limits, qd, viscous, coulomb, strict=True)
        ]
        push = transpose_multiply(
            self._kinematics.jacobian(q, plant.tool), plant.force_sensor.applied
        )
        inner = plant.coriolis(q, qd)
        net = [
            max(-limit, min(limit, t)) - d - c + p
            for limit, t, d, c, p in zip(limits, load, drag, inner, push, strict=True)
        ]
        qdd = solve(plant.mass_matrix(q), net)
        arm.command_velocity([(v + a * arm.dt) / arm.scale for v, a in zip(qd, qdd, strict=True)])
        yield

    def _ticks(self, seconds: float) -> int:
        return max(1, round(seconds / self._arm.dt))


def _approach_vector(current: Floats, goal: Floats, step: float) -> list[float]:
    """Move a 3-vector towards `goal` on a straight line by at most `step`."""
    delta = [g - c for c, g in zip(current, goal, strict=True)]
    distance = norm(delta)
    if distance <= step:
        return list(goal)
    return [c + d * step / distance for c, d in zip(current, delta, strict=True)]


def _acceleration(name: str, value: Any) -> float:
    """Check an acceleration, which may be 0: the speed stays, as between equal points of a spline."""
    if not isinstance(value, (int, float)) or not isfinite(value) or value < 0.0:
        raise ScriptRuntimeError(f"{name}: expected a number of at least zero, got {value}")
    return float(value)


def _scales(name: str, value: Any, default: Floats, full: float) -> list[float]:
    if value is None:
        return [full * x for x in default]
    return [max(0.0, min(1.0, x)) for x in six(f"direct_torque {name}", value)]
