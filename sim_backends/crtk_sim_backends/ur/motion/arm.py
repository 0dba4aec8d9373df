"""The joints: what is commanded, what the drives aim at, and where the arm really is.

Three layers. The *plan* is what motion built-ins command, in path time. The *target* is the plan
after the speed slider and the compliant modes, and is what RTDE calls target_q. The *actual*
joint follows its target with a small lag.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import exp
from typing import Final

from crtk_sim_backends.ur.models import RobotModel
from crtk_sim_backends.ur.motion.kinematics import Floats
from crtk_sim_backends.ur.motion.limits import JOINT_SPEED, VIOLATION

TRACKING_TIME: Final = 0.006  # lag of an actual joint behind its target, s
BRAKE_DECELERATION: Final = 60.0  # rad/s^2
DEVIATION_LIMIT: Final = 0.15  # between target and actual joint position, rad
STEADY_SECONDS: Final = 0.5
HISTORY_SECONDS: Final = 4.0
FORGIVING_SECONDS: Final = 1.0
HOME: Final = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)  # rad, where a simulated arm wakes up

_SNAP = 1e-8  # rad: an actual joint closer to a resting target has arrived
_SERVO_SNAP = 1e-9
_SPEED_TOLERANCE = 1.0 + 1e-6


@dataclass(frozen=True)
class LimitViolation:
    """A joint left its limits: error code and argument, see `safety.STOP_REASONS`."""

    code: int
    argument: int


SUDDEN_CHANGE: Final = LimitViolation(204, 1)
"""A commanded position is farther away than a joint can turn in one period."""


def approach(current: Floats, goal: Floats, step: float) -> list[float]:
    """Move a vector towards `goal` on a straight line, its largest component by at most `step`."""
    largest = 0.0
    for a, b in zip(current, goal, strict=True):
        distance = abs(b - a)
        if distance > largest:
            largest = distance
    if largest <= step:
        return list(goal)
    factor = step / largest
    return [a + (b - a) * factor for a, b in zip(current, goal, strict=True)]


class Arm:
    """Six joints in virtual time; `step` advances them by one control period `dt`, s."""

    def __init__(self, model: RobotModel, dt: float, q: Floats = HOME) -> None:
        self.model = model
        self.dt = dt
        self.enabled = False  # powered with the brakes released
        self.scale = 1.0  # path time to time: speed slider, pause, reduced mode
        self.stop_deceleration = 10.0
        self.plan_q = list(q)
        self.plan_qd = [0.0] * 6
        self.target_q = list(q)
        self.target_qd = [0.0] * 6
        self.target_qdd = [0.0] * 6
        self.actual_q = list(q)
        self.actual_qd = [0.0] * 6
        self.frozen: set[int] = set()
        self.history: deque[list[float]] = deque([list(q)], maxlen=round(HISTORY_SECONDS / dt))
        self.still_ticks = round(STEADY_SECONDS / dt)
        self._steady_ticks = self.still_ticks
        self._drift_qd = [0.0] * 6
        self._pending: tuple[list[float], list[float]] | None = None
        self._part: tuple[float, list[float]] | None = None  # of this period that is planned
        self._too_fast: LimitViolation | None = None  # what that violates where it is too fast
        self._tracking = 1.0 - exp(-dt / TRACKING_TIME)
        self._forgiving = 0  # periods

    @property
    def moving(self) -> bool:
        """Whether the target moves."""
        return any(self.target_qd)

    @property
    def steady(self) -> bool:
        """Whether the target has rested for `STEADY_SECONDS`."""
        return self.still_ticks >= self._steady_ticks

    @property
    def deviation(self) -> float:
        """Largest distance between target and actual joint position, rad."""
        return max([abs(t - a) for t, a in zip(self.target_q, self.actual_q, strict=True)])

    def command(self, q: list[float], qd: list[float]) -> None:
        """Plan position `q` at the end of this period, and its velocity in path time."""
        self._pending = (q, qd)
        self._too_fast = SUDDEN_CHANGE

    @property
    def time_left(self) -> float:
        """Path time of this period for which nothing is planned yet, s."""
        planned = 0.0 if self._part is None else self._part[0]
        return self.dt * self.scale - planned

    def command_velocity(self, qd: list[float], seconds: float | None = None) -> None:
        """Plan to move with `qd` (path time) for the rest of this period.

        With `seconds` of path time, fewer than are left, the next command may have what remains.
        """
        start, left = self.plan_q if self._part is None else self._part[1], self.time_left
        self._pending = ([p + v * left for p, v in zip(start, qd, strict=True)], qd)
        if seconds is not None:
            reached = [p + v * seconds for p, v in zip(start, qd, strict=True)]
            self._part = (self.dt * self.scale - left + seconds, reached)
        self._too_fast = None

    @property
    def commanded_q(self) -> list[float]:
        """Joint positions that the plan will have at the end of this period."""
        return self.plan_q if self._pending is None else self._pending[0]

    @property
    def commanded_qd(self) -> list[float]:
        """Joint velocity that the plan will have in this period, path time."""
        return self.plan_qd if self._pending is None else self._pending[1]

    def drift(self, qd: list[float]) -> None:
        """Give way with joint velocity `qd` on top of the plan (freedrive, force mode)."""
        self._drift_qd = qd

    def rebase(self) -> None:
        """Start planning from the target, which compliant modes may have moved off the plan."""
        self.plan_q = list(self.target_q)

    def forgive(self) -> None:
        """For `FORGIVING_SECONDS`, go to a servo target that is far away as fast as the joints can.

        A controller is never late. Where a busy machine has this one make up for periods, or leaves them out,
        its clients have gone on, and their targets have leaped through no fault of theirs.
        """
        self._forgiving = round(FORGIVING_SECONDS / self.dt)

    def servo(self, goal: Floats, lookahead: float, gain: float) -> None:
        """Follow `goal` as `servoj` does: critically damped, late by `lookahead` on a ramp.

        The filter of the controller is not published. This one has the documented effect of
        the lookahead time, and gains below 300 make it softer; acceleration is limited.
        """
        h = self.dt * self.scale
        if h <= 0.0:
            self.command(self.plan_q, self.plan_qd)
            return
        w = 2.0 / lookahead * min(1.0, (gain / 300.0) ** 0.5)
        decay = exp(-w * h)
        limit = self.model.acceleration * h
        q: list[float] = []
        qd: list[float] = []
        arrived = True
        for target, position, velocity, fastest in zip(
            goal, self.plan_q, self.plan_qd, self.model.velocity, strict=True
        ):
            error = position - target
            c = velocity + w * error
            wanted = (velocity - w * c * h) * decay
            new_velocity = max(velocity - limit, min(velocity + limit, wanted))
            if self._forgiving:
                new_velocity = max(-fastest, min(fastest, new_velocity))
            if new_velocity == wanted:
                way = (error + c * h) * decay - error
            else:
                way = 0.5 * (velocity + new_velocity) * h
            if self._forgiving:
                way = max(-fastest * h, min(fastest * h, way))
            error += way
            if abs(error) > _SERVO_SNAP or abs(new_velocity) > 100 * _SERVO_SNAP:
                arrived = False
            q.append(target + error)
            qd.append(new_velocity)
        if arrived:
            self.command(list(goal), [0.0] * 6)
        else:
            self.command(q, qd)

    def step(self) -> LimitViolation | None:
        """Advance one period. A returned violation has not been followed: the arm slows down."""
        pending = self._pending
        drift = self._drift_qd
        self._forgiving = max(0, self._forgiving - 1)
        self._pending = self._part = None
        violation = None
        if not self.enabled:
            pending = None
        if pending is None and not any(self.plan_qd) and not any(drift):
            self._rest()
        else:
            violation = self._advance(pending, drift)
        self._track()
        if violation is None and self.enabled and self.frozen:
            violation = self._deviating_joint()
        self.history.append(self.actual_q)
        return violation

    def put(self, q: Floats) -> None:
        """Be at rest at `q` at once, as only a simulated arm can."""
        self.plan_q, self.target_q, self.actual_q = list(q), list(q), list(q)
        self.actual_qd = [0.0] * 6

    def hold(self) -> None:
        """Drop the difference between target and actual, as brakes and a stopped drive do."""
        self.target_q = list(self.actual_q)
        self.plan_q = list(self.actual_q)

    def _rest(self) -> None:
        if any(self.target_qd) or any(self.target_qdd):
            self.target_qdd = [-v / self.dt for v in self.target_qd]
            self.target_qd = [0.0] * 6
        self.still_ticks += 1

    def _advance(
        self, pending: tuple[list[float], list[float]] | None, drift: list[float]
    ) -> LimitViolation | None:
        violation = None
        dt = self.dt
        if pending is not None:
            violation = self._check(pending, drift)
        if pending is None or violation is not None:
            pending = self._slow_down()
        q, qd = pending
        offset = [t - p for t, p in zip(self.target_q, self.plan_q, strict=True)]
        self.plan_q = q
        self.plan_qd = qd
        if any(drift) and self.enabled:
            drift = self._within_limits(drift)
            offset = [o + v * dt for o, v in zip(offset, drift, strict=True)]
        if any(offset):
            self.target_q = [p + o for p, o in zip(q, offset, strict=True)]
        else:
            self.target_q = list(q)
        scale = self.scale
        velocity = [v * scale + d for v, d in zip(qd, drift, strict=True)]
        self.target_qdd = [(v - w) / dt for v, w in zip(velocity, self.target_qd, strict=True)]
        self.target_qd = velocity
        self.still_ticks = 0 if any(velocity) else self.still_ticks + 1
        return violation

    def _check(
        self, pending: tuple[list[float], list[float]], drift: list[float]
    ) -> LimitViolation | None:
        """Position and speed limits of one command; a joint may always move back inside."""
        model = self.model
        dt = self.dt
        for i in range(6):
            q = pending[0][i]
            before = self.plan_q[i]
            if abs(q) > model.position[i] and abs(q) > abs(before):
                return LimitViolation(150, 0)
            limit = model.velocity[i] * _SPEED_TOLERANCE
            step = limit * dt * _SPEED_TOLERANCE
            if not (abs(pending[1][i]) <= limit and abs(q - before) <= step):  # NaN included
                return self._too_fast or LimitViolation(VIOLATION, JOINT_SPEED + i)
        return None

    def _slow_down(self) -> tuple[list[float], list[float]]:
        """Ramp the planned velocity down, all joints in proportion."""
        deceleration = self.stop_deceleration if self.enabled else BRAKE_DECELERATION
        scale = self.scale
        if scale <= 0.0:
            return self.plan_q, [0.0] * 6
        qd = approach(self.plan_qd, (0.0,) * 6, deceleration * self.dt / scale)
        h = self.dt * scale
        q = [p + 0.5 * (v + w) * h for p, v, w in zip(self.plan_q, self.plan_qd, qd, strict=True)]
        for i, limit in enumerate(self.model.position):
            if abs(q[i]) > limit and abs(q[i]) > abs(self.plan_q[i]):
                q[i] = self.plan_q[i]
        return q, qd

    def _within_limits(self, drift: list[float]) -> list[float]:
        """Drift that neither exceeds the joint speeds nor pushes a joint over its position limit."""
        limited = []
        for v, q, position, speed in zip(
            drift, self.target_q, self.model.position, self.model.velocity, strict=True
        ):
            v = max(-speed, min(speed, v))
            limited.append(0.0 if abs(q + v * self.dt) > position and v * q > 0.0 else v)
        return limited

    def _track(self) -> None:
        """Let the actual joints follow their targets."""
        if self.actual_q == self.target_q:
            if any(self.actual_qd):
                self.actual_qd = [0.0] * 6
            return
        k = self._tracking
        before = self.actual_q
        resting = not any(self.target_qd)
        q = []
        for i, (actual, target) in enumerate(zip(before, self.target_q, strict=True)):
            if i in self.frozen:
                q.append(actual)
                continue
            error = target - actual
            q.append(target if resting and abs(error) < _SNAP else actual + error * k)
        self.actual_q = q
        self.actual_qd = [(new - old) / self.dt for new, old in zip(q, before, strict=True)]

    def _deviating_joint(self) -> LimitViolation | None:
        for i, (target, actual) in enumerate(zip(self.target_q, self.actual_q, strict=True)):
            if abs(target - actual) > DEVIATION_LIMIT:
                return LimitViolation(153, i)
        return None
