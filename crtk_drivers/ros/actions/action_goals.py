"""The goals of an action server and what becomes of them. No ROS here.

States, and which goals a request cancels, are those of action_msgs (GoalStatus.msg, CancelGoal.srv).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, Final

KEPT: Final = 64
"""Goals that have ended and whose results are kept; of older ones nobody knows any more."""

NEVER = bytes(16)
"""No goal's id: in a request to cancel it means any."""


class GoalState(IntEnum):
    """What action_msgs/GoalStatus calls status."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


ENDED: Final = frozenset({GoalState.SUCCEEDED, GoalState.CANCELED, GoalState.ABORTED})

AFTER: Final[Mapping[GoalState, frozenset[GoalState]]] = MappingProxyType(
    {
        GoalState.ACCEPTED: frozenset(
            {GoalState.EXECUTING, GoalState.CANCELING, GoalState.ABORTED}
        ),
        GoalState.EXECUTING: frozenset(
            {GoalState.CANCELING, GoalState.SUCCEEDED, GoalState.ABORTED}
        ),
        GoalState.CANCELING: ENDED,
        **dict.fromkeys(ENDED, frozenset()),
    }
)
"""Which state may follow which."""


class CancelCode(IntEnum):
    """What action_msgs/CancelGoal answers."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


class Goal:
    """One accepted goal.

    Attributes:
        id: 16 bytes, chosen by the client.
        accepted_ns: when, since the epoch.
        state: where it stands.
        result: of one that has ended.
    """

    def __init__(self, goal_id: bytes, accepted_ns: int) -> None:
        self.id = goal_id
        self.accepted_ns = accepted_ns
        self.state = GoalState.ACCEPTED
        self.result: Any = None
        self._asking: list[Callable[[], None]] = []

    @property
    def has_ended(self) -> bool:
        """Whether nothing becomes of it any more."""
        return self.state in ENDED

    def become(self, state: GoalState) -> bool:
        """Change the state, if that may follow; return whether it does."""
        if state not in AFTER[self.state]:
            return False
        self.state = state
        return True

    def end(self, state: GoalState, result: Any) -> list[Callable[[], None]]:
        """Set the final state and result; return those that wait for it. The first end counts."""
        if not self.become(state):
            return []
        self.result = result
        asking, self._asking = self._asking, []
        return asking

    def ask(self, answer: Callable[[], None]) -> bool:
        """Let `answer` wait for the end; return False if there is nothing to wait for."""
        if self.has_ended:
            return False
        self._asking.append(answer)
        return True


class Goals:
    """The goals that a server knows: all that run, and the last ones that have ended."""

    def __init__(self) -> None:
        self._goals: dict[bytes, Goal] = {}

    def __iter__(self) -> Any:
        return iter(tuple(self._goals.values()))

    def get(self, goal_id: bytes) -> Goal | None:
        """Return a goal, None if nothing is known of it."""
        return self._goals.get(goal_id)

    def add(self, goal_id: bytes, accepted_ns: int) -> Goal:
        """Take a new goal, and forget the oldest of those that have ended if there are many."""
        ended = [goal for goal in self._goals.values() if goal.has_ended]
        for goal in ended[: max(0, len(ended) + 1 - KEPT)]:
            del self._goals[goal.id]
        goal = self._goals[goal_id] = Goal(goal_id, accepted_ns)
        return goal

    def to_cancel(self, goal_id: bytes, before_ns: int) -> tuple[CancelCode, list[Goal]]:
        """Return which goals a request cancels.

        Args:
            goal_id: of one goal; `NEVER` for any.
            before_ns: those accepted until then, beside it; 0 with `NEVER`: all.
        """
        named = self._goals.get(goal_id)
        if goal_id != NEVER and named is None and not before_ns:
            return CancelCode.UNKNOWN_GOAL_ID, []
        if named is not None and named.has_ended and not before_ns:
            return CancelCode.GOAL_TERMINATED, []
        every = goal_id == NEVER and not before_ns
        chosen = [
            goal
            for goal in self._goals.values()
            if not goal.has_ended and (every or goal is named or goal.accepted_ns <= before_ns)
        ]
        return CancelCode.NONE, chosen
