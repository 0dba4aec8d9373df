"""``gripper_cmd``: a gripper's fingers, by GripperCommand and ParallelGripperCommand of control_msgs.

What closes on something ends before its goal, and is meant to: a finger that stands for `STALL_TIME` has
stalled, and that is a success, as with ``allow_stalling`` of ros2_controllers'
parallel_gripper_action_controller.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from control_msgs.action import GripperCommand, ParallelGripperCommand
from typing_extensions import override

from crtk_drivers.device import Capabilities
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.motion.arbiter import Client
from crtk_drivers.motion.move import Move, Outcome
from crtk_drivers.motion.stopping import still_speeds
from crtk_drivers.ros.actions.action_goals import GoalState
from crtk_drivers.ros.actions.action_server import Behaviour, Pursuit
from crtk_drivers.ros.arrival import Arrival
from crtk_drivers.ros.joint_names import JointNames
from crtk_drivers.samples import JointState, vector

COMMAND: Final = "move_jp"

STALL_TIME: Final = 1.0
"""Seconds for which a finger stands that has stalled (``stall_timeout``)."""

NEAR: Final = 0.01
"""Share of its range within which a finger is at its goal, where the device does not say how near that is."""


@dataclass(frozen=True)
class Finger:
    """The one joint of a gripper.

    Attributes:
        name: of the joint on ROS.
        near: rad or m within which it is at its goal.
        still: rad/s or m/s below which it stands.
    """

    name: str
    near: float
    still: float


def finger_of(capabilities: Capabilities, names: JointNames) -> Finger:
    """Return the finger of a gripper."""
    (limit,), following = capabilities.limits, capabilities.following
    near = NEAR * (limit.upper - limit.lower) if following is None else following.arrival[0]
    return Finger(names.outgoing(capabilities.joints)[0], near, still_speeds(capabilities)[0])


class StallWatch:
    """Says when a finger that should move has stood for `STALL_TIME`.

    Args:
        still: rad/s or m/s below which it stands.
        now: monotonic seconds.
    """

    def __init__(self, still: float, now: float) -> None:
        self._still = still
        self._moved = now

    def stalled(self, velocity: float | None, now: float) -> bool:
        """Look at its velocity; None: not measured, which is believed to be motion."""
        if velocity is None or abs(velocity) > self._still:
            self._moved = now
        return now - self._moved >= STALL_TIME


@dataclass(frozen=True)
class Ending:
    """How a grip has ended."""

    state: GoalState
    stalled: bool
    reached: bool


def ending(outcome: Outcome, off: float, near: float, gave_way: bool, cancelled: bool) -> Ending:
    """Return how a grip has ended.

    Args:
        outcome: of its move.
        off: how far the finger is from the goal.
        near: within which it is there.
        gave_way: the move was ended because the finger had stalled.
        cancelled: a client cancelled it.
    """
    reached = off <= near
    if outcome is Outcome.REACHED or gave_way:
        return Ending(GoalState.SUCCEEDED, not reached, reached)
    return Ending(GoalState.CANCELED if cancelled else GoalState.ABORTED, False, reached)


class _Gripping(Pursuit):
    def __init__(
        self, move: Move, goal: float, engine: Engine, finger: Finger, told: Callable[..., Any]
    ) -> None:
        super().__init__(move)
        self._goal = goal
        self._engine = engine
        self._finger = finger
        self._watch = StallWatch(finger.still, time.monotonic())
        self._gave_way = False
        self._told = told

    @override
    def feedback(self) -> Any:
        state = self._state()
        velocity = float(state.velocity[0]) if state.velocity.size else None
        if self._watch.stalled(velocity, time.monotonic()) and not self._gave_way:
            self._gave_way = self.move.is_busy()
            self._engine.end_move(self.move, "the gripper has stalled")
        return self._told(False, state, self._gave_way, self._off(state) <= self._finger.near)

    @override
    def result(self) -> tuple[GoalState, Any]:
        state = self._state()
        move, off = self.move, self._off(state)
        end = ending(move.outcome, off, self._finger.near, self._gave_way, self.is_cancelled)
        return end.state, self._told(True, state, end.stalled, end.reached)

    def _off(self, state: JointState) -> float:
        return abs(float(state.position[0]) - self._goal) if state.position.size else float("inf")

    def _state(self) -> JointState:
        found = self._engine.feedback("measured_js")
        state = found[0] if found is not None else JointState()
        assert isinstance(state, JointState)
        return state


class _Grips(Behaviour):
    """What the two actions have in common: `told` writes a result (True) or feedback."""

    def __init__(self, engine: Engine, names: JointNames, admit: Callable[[str], None]) -> None:
        self._engine = engine
        self._admit = admit
        self._finger = finger_of(engine.capabilities, names)
        self._client = Client("a client of the gripper's action")

    @abstractmethod
    def _position(self, goal: Any) -> float:
        """Return where a goal wants the finger."""

    @abstractmethod
    def _told(self, ends: bool, state: JointState, stalled: bool, reached: bool) -> Any:
        """Return a result, or feedback."""

    @override
    def begin(self, goal: Any, arrival: Arrival) -> Pursuit:
        self._admit(COMMAND)
        position = self._position(goal)
        wanted = JointState(position=vector([position]))
        sent = arrival.earliest_ns
        move = self._engine.submit(COMMAND, wanted, client=self._client, sent_ns=sent)
        assert move is not None
        return _Gripping(move, position, self._engine, self._finger, self._told)


class Grip(_Grips):
    """GripperCommand. `max_effort` is not looked at: how hard it grips is set at the device."""

    action = GripperCommand

    @override
    def _position(self, goal: Any) -> float:
        return float(goal.command.position)

    @override
    def _told(self, ends: bool, state: JointState, stalled: bool, reached: bool) -> Any:
        kind = GripperCommand.Result if ends else GripperCommand.Feedback
        return kind(
            position=float(state.position[0]) if state.position.size else 0.0,
            effort=float(state.effort[0]) if state.effort.size else 0.0,
            stalled=bool(stalled),
            reached_goal=bool(reached),
        )


class ParallelGrip(_Grips):
    """ParallelGripperCommand. Its velocity and effort are not looked at."""

    action = ParallelGripperCommand

    @override
    def _position(self, goal: Any) -> float:
        names, positions = list(goal.command.name), list(goal.command.position)
        own = {self._finger.name, *self._engine.capabilities.joints}
        if len(positions) == 1 and len(names) <= 1 and own.issuperset(names):
            return float(positions[0])
        refusal = CommandRefused(
            COMMAND,
            Reason.WRONG_NAMES if len(positions) == 1 else Reason.WRONG_SIZE,
            f"a grip of {names[:10]} with {len(positions)} positions",
            where=self._engine.where,
            remedy=f"Name {self._finger.name}, or nothing, and give one position.",
        )
        self._engine.report_refusal(refusal)
        raise refusal

    @override
    def _told(self, ends: bool, state: JointState, stalled: bool, reached: bool) -> Any:
        told = ParallelGripperCommand.Result() if ends else ParallelGripperCommand.Feedback()
        told.state.name = [self._finger.name]
        told.state.position = state.position.tolist()
        told.state.velocity = state.velocity.tolist()
        told.state.effort = state.effort.tolist()
        if ends:
            told.stalled, told.reached_goal = bool(stalled), bool(reached)
        return told
