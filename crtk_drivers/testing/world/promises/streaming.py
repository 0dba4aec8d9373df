"""Streams of a user, of each kind that a device may take: what is sent, and how often.

`operations.py` chooses among them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from crtk_drivers.commands import Kind, Space, find
from crtk_drivers.samples import Pose, Vector, vector
from crtk_drivers.testing.world.promises.acting import User

CYCLE: Final = 0.008
PERIODS: Final = (CYCLE, CYCLE, 0.002, 0.05)
"""s between two setpoints of a stream."""
SLOW_PERIODS: Final = (0.01, 0.02, 0.05)
"""s between two goals of an interpolated one."""
_TOOL_SPEED: Final = 0.05
"""m/s of the fastest stream of the tool."""
_TOOL_FORCE: Final = 0.1
"""Share of the limit that is the greatest force of a stream."""


def _positions(user: User, period: float) -> Callable[[int], object]:
    start, speed = user.set_last(), user.signed(user.scene.subject.velocity)

    def position(count: int) -> Vector:
        wanted = start + speed * period * count * min(1.0, count / 10.0)
        return np.clip(wanted, user.lower, user.upper)

    return position


def _increments(user: User, period: float) -> Callable[[int], object]:
    speed = user.signed(user.scene.subject.velocity)

    def increment(count: int) -> Vector:
        here = user.set_last()
        wanted = here + speed * period * min(1.0, count / 10.0)
        return np.clip(wanted, user.lower, user.upper) - here

    return increment


def _velocities(user: User, _: float) -> Callable[[int], object]:
    wanted = np.full(user.lower.size, user.signed(user.scene.subject.velocity))
    return lambda count: wanted


def _efforts(user: User, _: float) -> Callable[[int], object]:
    limits = [limit.effort for limit in user.engine.capabilities.limits]
    wanted = user.scene.subject.effort * user.signed(1.0) * np.array(limits)
    return lambda count: wanted


def _poses(user: User, period: float) -> Callable[[int], object]:
    here: Pose = user.arm.measured_cp()
    way = user.way(_TOOL_SPEED * period)

    def pose(count: int) -> Pose:
        return Pose(vector(here.position + count * min(1.0, count / 10.0) * way), here.orientation)

    return pose


def _twists(user: User, _: float) -> Callable[[int], object]:
    wanted = [*user.way(_TOOL_SPEED), 0.0, 0.0, 0.0]
    return lambda count: wanted


def _wrenches(user: User, _: float) -> Callable[[int], object]:
    limits = user.engine.capabilities.cartesian_limits
    assert limits is not None
    wanted = [*user.way(_TOOL_FORCE * limits.force), 0.0, 0.0, 0.0]
    return lambda count: wanted


_VALUES: Final = {
    (Space.JOINT, Kind.POSITION): _positions,
    (Space.JOINT, Kind.RELATIVE): _increments,
    (Space.JOINT, Kind.VELOCITY): _velocities,
    (Space.JOINT, Kind.EFFORT): _efforts,
    (Space.CARTESIAN, Kind.POSITION): _poses,
    (Space.CARTESIAN, Kind.VELOCITY): _twists,
    (Space.CARTESIAN, Kind.EFFORT): _wrenches,
}
"""What makes the values of a stream, from its period: of the number of each."""


def stream(
    user: User,
    name: str,
    seconds: float,
    *,
    periods: Sequence[float] = PERIODS,
    arm: Any = None,
) -> None:
    """Stream for some s."""
    period = user.random.choice(periods)
    command = find(name)
    value = _VALUES[command.space, command.kind](user, period)
    for count in range(max(3, round(seconds / period))):
        user.stream(name, value(count), arm)
        time.sleep(period)


def stream_once(name: str, periods: Sequence[float] = PERIODS) -> Callable[[User], None]:
    """Return the operation that streams for less than half a second."""

    def act(user: User) -> None:
        stream(user, name, 0.04 + 0.36 * user.random.random(), periods=periods)

    return act
