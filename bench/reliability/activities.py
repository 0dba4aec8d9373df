"""What an arm does when a fault meets it: nothing, a stream or move of each kind, a transition that moves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.reliability.table import REST
from crtk_drivers.errors import CommandRefused, Reason

STEP_LIMIT = 0.02
"""Seconds by which the way of a stream of positions is continued at most, however late it is."""


UNHOMED = 2.0
"""Seconds in which `unhome` is carried out, which moves nothing."""


@dataclass(frozen=True)
class Plan:
    """How an arm is moved.

    Attributes:
        velocity: of its first joint, rad/s (m/s); the others stand.
        effort: of its first joint, N·m (N); 0: none.
        far: how far the first joint would go in a move, rad (m).
        linear: velocity of the tool along its base's y, m/s.
        force: at the tool along its base's y, N; 0: none.
        away: how far the tool would go in a move along y, m.
        ratio: of the velocity that moves usually have.
        period: seconds between two commands of a stream.
        room: how far (rad, m) from home a joint may be where an arm begins; it goes home from farther.
    """

    velocity: float
    far: float
    effort: float = 0.0
    linear: float = 0.0
    force: float = 0.0
    away: float = 0.0
    ratio: float = 1.0
    period: float = 0.01
    room: float = 0.0

    def reversed(self) -> Plan:
        """Return the same, the other way."""
        return replace(
            self,
            velocity=-self.velocity,
            far=-self.far,
            effort=-self.effort,
            linear=-self.linear,
            force=-self.force,
            away=-self.away,
        )


Send = Callable[[], Any]
Maker = Callable[[Any, Plan], Send]


def _first(arm: Any, value: float) -> np.ndarray:
    values = np.zeros(len(arm.engine.capabilities.joints))
    values[0] = value
    return values


def _constant(name: str, value: Callable[[Any, Plan], Any]) -> Maker:
    def make(arm: Any, plan: Plan) -> Send:
        constant = value(arm, plan)
        return lambda: getattr(arm, name)(constant)

    return make


def _here(arm: Any) -> np.ndarray:
    """Return where a stream of positions begins: at the setpoint, or without one where the joints are."""
    setpoint = arm.setpoint_jp(age=0)
    return np.array(setpoint if setpoint.size else arm.measured_jp(age=0))


@contextmanager
def _begun_anew(position: np.ndarray, here: Callable[[], np.ndarray]) -> Iterator[None]:
    """Let a stream that ran ahead of a driver that was held up go on from where that is; it stays refused."""
    try:
        yield
    except CommandRefused as refusal:
        if refusal.reason is Reason.STEP_TOO_LARGE:
            position[:] = here()
        raise


def _positions(name: str) -> Maker:
    def make(arm: Any, plan: Plan) -> Send:
        position = _here(arm)
        last = time.monotonic()

        def send() -> None:
            nonlocal last
            now = time.monotonic()
            position[0] += plan.velocity * min(now - last, STEP_LIMIT)
            last = now
            with _begun_anew(position, lambda: _here(arm)):
                getattr(arm, name)(position.copy())

        return send

    return make


def _poses(name: str) -> Maker:
    def make(arm: Any, plan: Plan) -> Send:
        begin = arm.setpoint_cp(age=0)
        position = np.array(begin.position)
        last = time.monotonic()

        def send() -> None:
            nonlocal last
            now = time.monotonic()
            position[1] += plan.linear * min(now - last, STEP_LIMIT)
            last = now
            with _begun_anew(position, lambda: arm.setpoint_cp(age=0).position):
                getattr(arm, name)(
                    begin.__class__(position.copy(), begin.orientation, begin.frame_id)
                )

        return send

    return make


def _joint_goal(arm: Any, plan: Plan) -> np.ndarray:
    return _here(arm) + _first(arm, plan.far)


def _pose_goal(arm: Any, plan: Plan) -> Any:
    begin = arm.setpoint_cp(age=0)
    there = begin.position + np.array([0.0, plan.away, 0.0])
    return begin.__class__(there, begin.orientation, begin.frame_id)


def _along_y(value: float) -> list[float]:
    return [0.0, value, 0.0, 0.0, 0.0, 0.0]


STREAMS: Mapping[str, Maker] = {
    "servo_jp": _positions("servo_jp"),
    "servo_jv": _constant("servo_jv", lambda arm, plan: _first(arm, plan.velocity)),
    "servo_jf": _constant("servo_jf", lambda arm, plan: _first(arm, plan.effort)),
    "servo_cp": _poses("servo_cp"),
    "servo_cv": _constant("servo_cv", lambda arm, plan: _along_y(plan.linear)),
    "servo_cf": _constant("servo_cf", lambda arm, plan: _along_y(plan.force)),
    "interpolate_jp": _positions("interpolate_jp"),
    "interpolate_jv": _constant("interpolate_jv", lambda arm, plan: _first(arm, plan.velocity)),
    "interpolate_cp": _poses("interpolate_cp"),
}
"""Sent again and again, each `Plan.period`."""

ONCE: Mapping[str, Maker] = {
    "move_jp": _constant("move_jp", _joint_goal),
    "move_cp": _constant("move_cp", _pose_goal),
    "free": lambda arm, plan: arm.free,
}
"""Sent once."""

HOME = "home"
TRANSITIONS = (HOME,)
"""Begun once, and seen through by the driver. A rig lists those that move its joints."""

ALL = (REST, *STREAMS, *ONCE, *TRANSITIONS)
STANDING = frozenset({REST, "free"})
"""In which nothing moves by itself."""
MOVES = frozenset({"move_jp", "move_cp"})
OF_THE_TOOL = frozenset({"servo_cp", "servo_cv", "servo_cf", "interpolate_cp", "move_cp"})
EFFORTS = frozenset({"servo_jf", "servo_cf"})
"""In which a joint goes on as long as nobody looks."""


def _home(arm: Any) -> None:
    """Begin to home, also what is homed already."""
    engine = arm.engine
    engine.state_command("unhome")
    deadline = time.monotonic() + UNHOMED
    while engine.status.is_homed or not engine.transition_ended:
        if time.monotonic() > deadline:
            return
        time.sleep(STEP_LIMIT / 10.0)
    engine.state_command(HOME)


class Activity:
    """One of `ALL`, of one arm. `send` goes on with it; what is refused raises CommandRefused."""

    def __init__(self, name: str, arm: Any, plan: Plan) -> None:
        self.name = name
        self.move: Any = None
        self._due = 0.0 if name in STREAMS else math.inf
        self._period = plan.period
        self._send: Send = STREAMS[name](arm, plan) if name in STREAMS else lambda: None
        if name in ONCE:
            arm.trajectory_j.set_ratio_v(plan.ratio)
            self.move = ONCE[name](arm, plan)()
        elif name == HOME:
            _home(arm)

    def send(self) -> None:
        """Send the next command of a stream if it is due."""
        now = time.monotonic()
        if now >= self._due:
            self._due = now + self._period
            self._send()
