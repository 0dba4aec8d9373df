"""``follow_joint_trajectory`` (control_msgs/action/FollowJointTrajectory): a trajectory as a move."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

from control_msgs.action import FollowJointTrajectory
from trajectory_msgs.msg import JointTrajectoryPoint
from typing_extensions import override

from crtk_drivers.commands import FOLLOW
from crtk_drivers.engine import Engine
from crtk_drivers.motion.arbiter import Client
from crtk_drivers.motion.move import Move, Outcome, Violated
from crtk_drivers.recording.cdr_trajectories import decode_goal
from crtk_drivers.ros.actions.action_goals import GoalState
from crtk_drivers.ros.actions.action_server import Behaviour, Pursuit
from crtk_drivers.ros.arrival import Arrival
from crtk_drivers.ros.joint_names import JointNames
from crtk_drivers.ros.messages import set_stamp
from crtk_drivers.ros.trajectory_input import read_trajectory, require_common_clock
from crtk_drivers.samples import JointState

SUCCESSFUL: Final = 0
INVALID_GOAL: Final = -1

CODES: Final[Mapping[Violated | None, int]] = MappingProxyType(
    {Violated.PATH: -4, Violated.GOAL: -5, None: INVALID_GOAL}
)
"""``error_code`` of what did not come to its end, by the tolerance that was violated."""


def ended(
    outcome: Outcome, violated: Violated | None, reason: str, cancelled: bool
) -> tuple[GoalState, int, str]:
    """Return state, code and words of a trajectory that has ended. What succeeds has no code but 0."""
    if outcome is Outcome.REACHED:
        return GoalState.SUCCEEDED, SUCCESSFUL, "Goal successfully reached!"
    if cancelled and violated is None:
        return GoalState.CANCELED, SUCCESSFUL, reason
    return GoalState.ABORTED, CODES[violated], f"{outcome}: {reason}"


class FollowTrajectory(Behaviour):
    """Trajectories of one device.

    Args:
        engine: of the device.
        names: of its joints.
        admit: called before each goal; may refuse it.
    """

    action = FollowJointTrajectory
    takes_bytes = True

    def __init__(self, engine: Engine, names: JointNames, admit: Callable[[str], None]) -> None:
        self._engine = engine
        self._names = names
        self._admit = admit
        self._client = Client(f"a client of the action {FOLLOW.name}")

    @override
    def begin(self, goal: bytes, arrival: Arrival) -> Pursuit:
        self._admit(FOLLOW.name)
        asked = read_trajectory(self._engine, self._names, goal, decode_goal)
        require_common_clock(self._engine, asked, arrival)
        sent = arrival.earliest_ns
        move = self._engine.submit(FOLLOW.name, asked, client=self._client, sent_ns=sent)
        assert move is not None
        return _Following(move, self._names.outgoing(self._engine.capabilities.joints))


class _Following(Pursuit):
    def __init__(self, move: Move, names: tuple[str, ...]) -> None:
        super().__init__(move)
        self._names = list(names)

    @override
    def feedback(self) -> Any:
        progress = self.move.progress
        if progress is None:
            return None
        feedback = FollowJointTrajectory.Feedback(joint_names=self._names)
        set_stamp(feedback.header.stamp, time.time_ns())
        desired, actual = progress.desired, progress.actual
        error = JointState(
            position=_difference(desired.position, actual.position),
            velocity=_difference(desired.velocity, actual.velocity),
        )
        feedback.desired = _point(desired, progress.time)
        feedback.actual = _point(actual, progress.time)
        feedback.error = _point(error, progress.time)
        return feedback

    @override
    def result(self) -> tuple[GoalState, Any]:
        move = self.move
        state, code, text = ended(move.outcome, move.violated, move.reason, self.is_cancelled)
        return state, FollowJointTrajectory.Result(error_code=code, error_string=text)


def _difference(wanted: Any, is_: Any) -> Any:
    return wanted - is_ if wanted.size == is_.size else is_[:0]


def _point(joints: JointState, seconds: float) -> JointTrajectoryPoint:
    point = JointTrajectoryPoint(
        positions=joints.position.tolist(), velocities=joints.velocity.tolist()
    )
    whole = int(seconds)
    point.time_from_start.sec = whole
    point.time_from_start.nanosec = int((seconds - whole) * 1e9)
    return point
