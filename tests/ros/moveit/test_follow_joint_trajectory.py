"""``follow_joint_trajectory`` over DDS, by rclpy's own action client, on the virtual arm."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from action_msgs.srv import CancelGoal
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance

from crtk_drivers import plugins
from crtk_drivers.config import from_values, load
from crtk_drivers.samples import JointState, vector
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from rigs.action_client import (
    ABORTED,
    CANCELED,
    SUCCEEDED,
    ActionAsker,
    as_moveit,
    set_duration,
    trajectory_goal,
)
from rigs.moveit_node import MoveItRig, moveit_rig
from rigs.waiting import LONG, eventually

SPACE = "/followed"
FOR_LONG = 15.0
"""Seconds from point to point of what is ended on its way, however long that takes."""


@pytest.fixture(scope="module")
def shared() -> Iterator[MoveItRig]:
    plugin = plugins.device("virtual")
    session = Session(
        plugin,
        load(plugin.config, from_values({**plugin.typical, "rate": 200.0, "sample_timeout": 3.0})),
    )
    with moveit_rig(session, SPACE) as rig:
        yield rig


@pytest.fixture
def rig(shared: MoveItRig) -> MoveItRig:
    shared.reach("disable", OperatingState.DISABLED)
    return shared.enabled()


def offsets(rig: MoveItRig, *values: float, every: float = 0.2) -> list[tuple[float, np.ndarray]]:
    begin = rig.joints()
    return [(every * index, begin + value) for index, value in enumerate(values)]


def test_a_single_point_that_is_hardly_ahead_is_gone_to(rig: MoveItRig) -> None:
    there = rig.joints() + 0.01
    asked = rig.asker.ask(as_moveit(rig.names, [(0.02, there)]))
    status, result = asked.wait()
    assert (status, result.error_code) == (SUCCEEDED, 0)
    assert rig.joints() == pytest.approx(there, abs=0.005)


def test_a_trajectory_is_gone_along_and_ends_in_success(rig: MoveItRig) -> None:
    rows = offsets(rig, 0.0, 0.03, 0.06)
    asked = rig.asker.ask(as_moveit(rig.names, rows))
    status, result = asked.wait()
    assert (status, result.error_code) == (SUCCEEDED, 0)
    assert result.error_string == "Goal successfully reached!"
    assert rig.joints() == pytest.approx(rows[-1][1], abs=0.01)
    eventually(lambda: not rig.engine.status.is_busy, "no longer busy")


def test_feedback_tells_desired_actual_and_error(rig: MoveItRig) -> None:
    asked = rig.asker.ask(as_moveit(rig.names, offsets(rig, 0.0, 0.1, 0.2, every=FOR_LONG)))
    eventually(lambda: len(asked.feedback) > 5, "feedback has come")
    asked.cancel()
    asked.wait()
    for told in asked.feedback:
        assert list(told.joint_names) == list(rig.names)
        wanted, is_ = np.array(told.desired.positions), np.array(told.actual.positions)
        assert told.error.positions == pytest.approx(wanted - is_)
        assert len(told.desired.velocities) == len(rig.names)
    times = [
        t.desired.time_from_start.sec + 1e-9 * t.desired.time_from_start.nanosec
        for t in asked.feedback
    ]
    assert times == sorted(times)


REJECTED = [
    ("unknown_joint", lambda goal: goal.trajectory.joint_names.__setitem__(0, "elbow")),
    ("times that go back", lambda goal: set_duration(goal.trajectory.points[1].time_from_start, 9.0)),
    ("NaN", lambda goal: goal.trajectory.points[1].positions.__setitem__(0, float("nan"))),
    ("another size", lambda goal: goal.trajectory.points[1].positions.pop()),
    ("no points", lambda goal: goal.trajectory.points.clear()),
    ("a goal in the past", lambda goal: setattr(goal.trajectory.header.stamp, "sec", 1)),
    ("efforts", lambda goal: setattr(goal.trajectory.points[0], "effort", [0.0] * 7)),
    ("a floating base", lambda goal: setattr(goal.multi_dof_trajectory, "joint_names", ["base"])),
]  # fmt: skip


def refused(rig: MoveItRig) -> int:
    counted = rig.engine.health().refusals.items()
    return sum(count for name, count in counted if name.startswith("follow_joint_trajectory: "))


@pytest.mark.parametrize("spoil", [row[1] for row in REJECTED], ids=[row[0] for row in REJECTED])
def test_what_cannot_be_followed_is_rejected_with_a_reason(rig: MoveItRig, spoil: object) -> None:
    before = refused(rig)
    goal = trajectory_goal(rig.names, offsets(rig, 0.0, 0.01, 0.02))
    spoil(goal)  # type: ignore[operator]
    assert rig.asker.send(goal) is None
    assert refused(rig) == before + 1
    assert not rig.engine.status.is_busy


def test_a_goal_is_rejected_while_the_device_is_not_enabled(rig: MoveItRig) -> None:
    rig.reach("disable", OperatingState.DISABLED)
    assert rig.asker.send(trajectory_goal(rig.names, offsets(rig, 0.0, 0.01))) is None


def test_cancel_holds_and_ends_it_as_canceled(rig: MoveItRig) -> None:
    asked = rig.asker.ask(as_moveit(rig.names, offsets(rig, 0.0, 0.1, 0.2, every=FOR_LONG)))
    eventually(lambda: bool(asked.feedback), "it is on its way")
    assert asked.cancel().return_code == CancelGoal.Response.ERROR_NONE
    status, _ = asked.wait()
    assert status == CANCELED
    here = rig.joints()
    eventually(lambda: not rig.engine.status.is_busy, "no longer busy")
    assert rig.engine.status.state is OperatingState.ENABLED
    assert rig.joints() == pytest.approx(here, abs=0.02)
    again = asked.cancel()
    assert again.return_code == CancelGoal.Response.ERROR_GOAL_TERMINATED
    assert rig.asker.ask(as_moveit(rig.names, offsets(rig, 0.0, 0.0))).wait()[0] == SUCCEEDED


def test_a_second_client_replaces_the_goal_of_the_first(rig: MoveItRig) -> None:
    first = rig.asker.ask(as_moveit(rig.names, offsets(rig, 0.0, 0.1, 0.2, every=FOR_LONG)))
    with ActionAsker(FollowJointTrajectory, f"{SPACE}/follow_joint_trajectory", "another") as other:
        begin = rig.joints()
        second = other.ask(trajectory_goal(rig.names, [(0.6, begin)]))
        status, result = first.wait()
        assert (status, result.error_code) == (ABORTED, -1)
        assert "pre-empted: by follow_joint_trajectory" in result.error_string
        assert second.wait()[0] == SUCCEEDED
    assert rig.joints() == pytest.approx(begin, abs=0.01)


def test_a_violated_path_tolerance_ends_it_with_its_code(rig: MoveItRig) -> None:
    tight = JointTolerance(name=rig.names[0], velocity=1e-9)
    goal = trajectory_goal(rig.names, offsets(rig, 0.0, 0.1, 0.2), path_tolerance=[tight])
    status, result = rig.asker.ask(goal).wait()
    assert (status, result.error_code) == (ABORTED, -4)
    assert rig.names[0] in result.error_string


def test_a_goal_tolerance_that_is_not_met_in_its_time_ends_it_with_its_code(rig: MoveItRig) -> None:
    tight = JointTolerance(name=rig.names[0], position=1e-15)
    goal = trajectory_goal(rig.names, offsets(rig, 0.0, 0.02), goal_tolerance=[tight])
    set_duration(goal.goal_time_tolerance, 0.001)
    status, result = rig.asker.ask(goal).wait()
    assert (status, result.error_code) == (ABORTED, -5)


@pytest.mark.parametrize("stop", ["disable", "pause", "hold", "move_jp"])
def test_what_else_ends_it_aborts_it_with_words(rig: MoveItRig, stop: str) -> None:
    asked = rig.asker.ask(as_moveit(rig.names, offsets(rig, 0.0, 0.1, 0.2, every=FOR_LONG)))
    eventually(lambda: bool(asked.feedback), "it is on its way")
    if stop == "move_jp":
        rig.engine.submit(stop, JointState(position=vector(rig.joints())))
    elif stop == "hold":
        rig.engine.submit(stop)
    else:
        rig.engine.state_command(stop)
    status, result = asked.wait()
    assert (status, result.error_code) == (ABORTED, -1)
    assert result.error_string


def test_a_hundred_thousand_points_are_rejected_and_the_io_thread_notices_nothing(
    rig: MoveItRig,
) -> None:
    goal = trajectory_goal(rig.names, [])
    goal.trajectory.points = (
        trajectory_goal(rig.names, offsets(rig, 0.0)).trajectory.points * 100_000
    )
    assert rig.asker.send(goal) is None
    assert rig.engine.status.state is OperatingState.ENABLED


def test_a_goal_from_before_hold_is_not_pursued_after(rig: MoveItRig) -> None:
    engine = rig.engine
    busy, free = threading.Event(), threading.Event()

    def hear(name: str, value: Any, stamp_ns: int) -> None:
        if name == "follow_joint_trajectory":
            busy.set()
            assert free.wait(LONG)

    goal = as_moveit(rig.names, offsets(rig, 0.0, 0.3, every=FOR_LONG))
    before, engine.hearers = engine.hearers, (*engine.hearers, hear)
    asked: list[Any] = []
    asking = threading.Thread(target=lambda: asked.append(rig.asker.send(goal)))
    asking.start()
    try:
        assert busy.wait(LONG)
        engine.submit("hold")
    finally:
        free.set()
        asking.join()
        engine.hearers = before
    assert asked == [None], "it was accepted"
    assert not engine.status.is_busy
