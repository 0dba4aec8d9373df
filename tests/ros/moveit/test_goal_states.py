"""What becomes of the goals of an action server, how trajectories and grips end: tables, without ROS."""

from __future__ import annotations

import pytest

from crtk_drivers.motion.move import Outcome, Violated
from crtk_drivers.ros.actions.action_goals import KEPT, NEVER, CancelCode, Goal, Goals, GoalState
from crtk_drivers.ros.actions.grippers import STALL_TIME, StallWatch, ending
from crtk_drivers.ros.actions.trajectories import ended

S = GoalState
ENDS = [
    # outcome, violated, cancelled -> state, code
    (Outcome.REACHED, None, False, S.SUCCEEDED, 0),
    (Outcome.REACHED, None, True, S.SUCCEEDED, 0),
    (Outcome.PREEMPTED, None, True, S.CANCELED, 0),
    (Outcome.ABORTED, None, True, S.CANCELED, 0),
    (Outcome.PREEMPTED, None, False, S.ABORTED, -1),
    (Outcome.ABORTED, None, False, S.ABORTED, -1),
    (Outcome.ABORTED, Violated.PATH, False, S.ABORTED, -4),
    (Outcome.ABORTED, Violated.GOAL, False, S.ABORTED, -5),
    (Outcome.ABORTED, Violated.PATH, True, S.ABORTED, -4),
]


@pytest.mark.parametrize(("outcome", "violated", "cancelled", "state", "code"), ENDS)
def test_how_a_trajectory_ends(
    outcome: Outcome, violated: Violated | None, cancelled: bool, state: GoalState, code: int
) -> None:
    told = ended(outcome, violated, "because", cancelled)
    assert told[:2] == (state, code)
    assert told[2]
    assert (told[0] is S.SUCCEEDED) <= (told[1] == 0), "a success with a code"


GRIPS = [
    # outcome, off, gave way, cancelled -> state, stalled, reached
    (Outcome.REACHED, 0.0, False, False, S.SUCCEEDED, False, True),
    (Outcome.REACHED, 0.03, False, False, S.SUCCEEDED, True, False),
    (Outcome.PREEMPTED, 0.03, True, False, S.SUCCEEDED, True, False),
    (Outcome.PREEMPTED, 0.03, False, True, S.CANCELED, False, False),
    (Outcome.PREEMPTED, 0.03, False, False, S.ABORTED, False, False),
    (Outcome.ABORTED, 0.03, False, False, S.ABORTED, False, False),
]


@pytest.mark.parametrize(
    ("outcome", "off", "gave_way", "cancelled", "state", "stalled", "reached"), GRIPS
)
def test_how_a_grip_ends(
    outcome: Outcome,
    off: float,
    gave_way: bool,
    cancelled: bool,
    state: GoalState,
    stalled: bool,
    reached: bool,
) -> None:
    told = ending(outcome, off, 0.001, gave_way, cancelled)
    assert (told.state, told.stalled, told.reached) == (state, stalled, reached)


def test_a_finger_has_stalled_when_it_has_stood_for_its_time() -> None:
    watch = StallWatch(0.01, 10.0)
    assert not watch.stalled(0.0, 10.0 + 0.9 * STALL_TIME)
    assert not watch.stalled(0.5, 10.0 + 1.1 * STALL_TIME)
    assert not watch.stalled(0.0, 10.0 + 2.0 * STALL_TIME)
    assert watch.stalled(-0.005, 10.0 + 2.2 * STALL_TIME)
    assert not watch.stalled(None, 30.0), "what is not measured may move"


def goal_in(state: GoalState) -> Goal:
    goal = Goal(bytes([1] * 16), 0)
    for step in {
        S.EXECUTING: (S.EXECUTING,),
        S.CANCELING: (S.CANCELING,),
        S.SUCCEEDED: (S.EXECUTING, S.SUCCEEDED),
        S.CANCELED: (S.CANCELING, S.CANCELED),
        S.ABORTED: (S.ABORTED,),
    }.get(state, ()):
        assert goal.become(step)
    return goal


@pytest.mark.parametrize("first", [S.SUCCEEDED, S.CANCELED, S.ABORTED])
@pytest.mark.parametrize("then", list(S))
def test_what_has_ended_stays_as_it_ended(first: GoalState, then: GoalState) -> None:
    goal = goal_in(first)
    assert not goal.become(then)
    assert goal.state is first


@pytest.mark.parametrize("end", [S.SUCCEEDED, S.CANCELED, S.ABORTED])
def test_what_is_being_cancelled_may_still_end_in_any_way(end: GoalState) -> None:
    goal = goal_in(S.CANCELING)
    assert not goal.become(S.EXECUTING)
    assert goal.become(end)


def test_what_was_not_cancelled_cannot_end_as_cancelled() -> None:
    assert not goal_in(S.EXECUTING).become(S.CANCELED)


def test_who_waits_for_a_result_hears_of_the_first_end_once() -> None:
    goal = goal_in(S.EXECUTING)
    told: list[str] = []
    assert goal.ask(lambda: told.append("first"))
    for answer in goal.end(S.SUCCEEDED, "result"):
        answer()
    assert goal.end(S.ABORTED, "another") == []
    assert not goal.ask(lambda: told.append("late"))
    assert (told, goal.result) == (["first"], "result")


A, B, C = (bytes([number] * 16) for number in (1, 2, 3))
CANCELS = [
    # asked for, accepted until -> code, goals; A was accepted at 10, B at 20, C has ended
    (NEVER, 0, CancelCode.NONE, [A, B]),
    (A, 0, CancelCode.NONE, [A]),
    (NEVER, 15, CancelCode.NONE, [A]),
    (B, 15, CancelCode.NONE, [A, B]),
    (C, 0, CancelCode.GOAL_TERMINATED, []),
    (bytes([9] * 16), 0, CancelCode.UNKNOWN_GOAL_ID, []),
    (NEVER, 5, CancelCode.NONE, []),
]


@pytest.mark.parametrize(("goal_id", "before", "code", "chosen"), CANCELS)
def test_which_goals_a_request_cancels(
    goal_id: bytes, before: int, code: CancelCode, chosen: list[bytes]
) -> None:
    goals = Goals()
    for each, accepted in ((A, 10), (B, 20), (C, 5)):
        goals.add(each, accepted).become(S.EXECUTING)
    ended_goal = goals.get(C)
    assert ended_goal is not None
    ended_goal.end(S.SUCCEEDED, None)
    found = goals.to_cancel(goal_id, before)
    assert (found[0], [goal.id for goal in found[1]]) == (code, chosen)


def test_only_the_last_results_are_kept_and_nothing_that_runs_is_forgotten() -> None:
    goals = Goals()
    runs = goals.add(A, 0)
    runs.become(S.EXECUTING)
    for number in range(3 * KEPT):
        goals.add(number.to_bytes(16, "big"), number).end(S.ABORTED, None)
    assert goals.get(A) is runs
    assert goals.get((0).to_bytes(16, "big")) is None
    assert len(list(goals)) <= KEPT + 1
