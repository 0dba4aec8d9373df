"""Whether a move has arrived at its goal, as the setpoint tells, and when that was told."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from crtk_drivers.commands import Command
from crtk_drivers.samples import JointState, Pose, Value

if TYPE_CHECKING:
    from crtk_drivers.client.inbox import Inbox, Received

JOINT_TOLERANCE = 1e-3
"""Radians or metres by which the setpoint at the end of a move may differ from its goal."""
LINEAR_TOLERANCE = 1e-3
ANGULAR_TOLERANCE = 5e-3
SETTLE_TIME = 0.5
"""Seconds after busy in which the setpoint must be at the goal."""

MOST_GOALS: Final = 20
"""Moves of which the goals are remembered."""


class ToldGoals:
    """The goals of moves of ours, as the device tells them: with the stamp of the command.

    Args:
        inbox: of ``goal_js`` or ``goal_cp``.
    """

    def __init__(self, inbox: Inbox) -> None:
        self._goals: dict[int, Value | None] = {}
        inbox.add_listener(self._hear)

    def expect(self, stamp_ns: int) -> None:
        """Keep the goal of a command that is about to be sent with a stamp."""
        self._goals[stamp_ns] = None
        for oldest in tuple(self._goals)[:-MOST_GOALS]:
            self._goals.pop(oldest, None)

    def of(self, stamp_ns: int) -> Value | None:
        """Return the goal of the command with a stamp; None if it was not told."""
        return self._goals.get(stamp_ns)

    def _hear(self, received: Received) -> None:
        if received.wall_ns in self._goals:
            self._goals[received.wall_ns] = received.value


class Arrival(NamedTuple):
    """What tells whether a move has arrived.

    Attributes:
        at_goal: whether the setpoint is at the goal; None as long as that is not known.
        told_at: when (monotonic, s) the newest setpoint arrived; infinity where none can ever tell.
    """

    at_goal: Callable[[], bool | None]
    told_at: Callable[[], float]


UNTELLABLE: Final = Arrival(lambda: None, lambda: math.inf)


def arrival_of(
    command: Command,
    setpoint: Inbox | None,
    goal: Value | None,
    told: ToldGoals | None,
    stamp_ns: int,
) -> Arrival:
    """Return what tells of a move that is about to be sent; of a relative one the device tells the goal."""
    if setpoint is None:
        return UNTELLABLE
    if not command.is_relative:
        if goal is None:
            return UNTELLABLE
        return Arrival(lambda: _is_at(setpoint, goal), _told_at(setpoint))
    if told is None or not stamp_ns:
        return UNTELLABLE
    told.expect(stamp_ns)
    return Arrival(lambda: _is_at(setpoint, told.of(stamp_ns)), _told_at(setpoint))


def _is_at(setpoint: Inbox, goal: Value | None) -> bool | None:
    told = setpoint.readable()
    if told is None or goal is None or _is_silent(setpoint):
        return None
    return _near(told.value, goal)


def _is_silent(setpoint: Inbox) -> bool:
    """Whether only invalid setpoints have come for too long to be a few that came late."""
    valid, latest = setpoint.valid, setpoint.latest
    return valid is None or (latest is not None and latest.arrived - valid.arrived > SETTLE_TIME)


def _told_at(setpoint: Inbox) -> Callable[[], float]:
    def at() -> float:
        told = setpoint.latest if _is_silent(setpoint) else setpoint.valid
        return -math.inf if told is None else told.arrived

    return at


def _near(setpoint: Value, goal: Value) -> bool | None:
    if isinstance(setpoint, Pose) and isinstance(goal, Pose):
        distance = float(np.linalg.norm(setpoint.position - goal.position))
        cosine = min(1.0, abs(float(setpoint.orientation @ goal.orientation)))
        angle = 2.0 * float(np.arccos(cosine))
        return distance <= LINEAR_TOLERANCE and angle <= ANGULAR_TOLERANCE
    if not (isinstance(setpoint, JointState) and isinstance(goal, JointState)):
        return None
    wanted = goal.position
    if goal.name and setpoint.name:
        if set(goal.name) != set(setpoint.name):
            return None
        wanted = wanted[[goal.name.index(name) for name in setpoint.name]]
    if setpoint.position.size != wanted.size or not wanted.size:
        return None
    return bool(np.max(np.abs(setpoint.position - wanted)) <= JOINT_TOLERANCE)
