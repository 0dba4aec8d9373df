"""What MoveIt asks, in the order in which it asks, of every arm and gripper with its simulator."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from control_msgs.action import FollowJointTrajectory, GripperCommand, ParallelGripperCommand
from sensor_msgs.msg import JointState

from crtk_drivers import plugins
from crtk_drivers.config import NodeConfig
from crtk_drivers.errors import ConfigError
from crtk_drivers.ros.serving import Serving
from crtk_drivers.session import Session, open_session
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.loopback import PLUGIN as LOOPBACK
from crtk_drivers.testing.loopback import LoopbackConfig
from rigs.action_client import SUCCEEDED, ActionAsker, as_moveit
from rigs.loopback_node import served
from rigs.moveit_node import MOVEIT, MoveItRig
from rigs.ros_client import Inbox
from rigs.ur_bench import lenient, patient_config
from rigs.waiting import eventually

ALLOWED_START_TOLERANCE = 0.01
PATIENT = {"sample_timeout": 3.0}
ARMS: dict[str, dict[str, Any]] = {
    "canopen": {
        **PATIENT,
        "period": 0.01,
        "missed_cycles": 100,
        "heartbeat": {"ours_timeout": 5.0, "drives_timeout": 5.0},
    },
    "dynamixel": {**PATIENT, "rate": 100.0, "silent_timeout": 2.0, "watchdog": 2.5},
    "ur": {**PATIENT, "frequency": 125.0},
    "virtual": {**PATIENT, "rate": 100.0},
}


@contextmanager
def served_sim(
    name: str, space: str, kind: Any, action: str, values: dict[str, Any], **sim: Any
) -> Iterator[MoveItRig]:
    config = (
        patient_config(values) if name == "ur" else plugins.device(name).load_config(None, values)
    )
    session = open_session(name, config, sim=name != "virtual", sim_options=sim)
    node = NodeConfig(**{**MOVEIT.model_dump(), "joint_prefix": "left_"})
    with (
        lenient(),
        served(session, space, (), node),
        ActionAsker(kind, f"{space}/{action}") as asker,
    ):
        yield MoveItRig(session, asker, space)


@pytest.mark.parametrize("name", ARMS)
def test_moveit_plans_from_joint_states_executes_and_waits_until_they_stand(name: str) -> None:
    space = f"/moved_{name}"
    with served_sim(
        name, space, FollowJointTrajectory, "follow_joint_trajectory", ARMS[name]
    ) as rig:
        rig.enabled()
        told = Inbox()
        rig.asker.node.create_subscription(JointState, f"{space}/joint_states", told, 10)
        now = told.wait()
        assert list(now.name) == [f"left_{joint}" for joint in rig.names]
        start = np.array(now.position)
        assert start == pytest.approx(rig.joints(), abs=ALLOWED_START_TOLERANCE)
        way = np.where(np.arange(len(start)) % 2, 0.05, -0.05)
        limits = rig.engine.capabilities.limits
        middle = np.array([0.5 * (limit.lower + limit.upper) for limit in limits])
        way = np.abs(way) * np.where(np.isfinite(middle), np.sign(middle - start), 1.0)
        rows = [(0.0, start), (0.5, start + 0.5 * way), (1.0, start + way)]
        status, result = rig.asker.ask(as_moveit(now.name, rows)).wait()
        assert (status, result.error_code) == (SUCCEEDED, 0), result.error_string
        stands = told.wait(lambda m: np.abs(m.velocity).max(initial=0.0) < 0.05, since=told.mark())
        assert np.array(stands.position) == pytest.approx(rows[-1][1], abs=0.02)


def test_the_gripper_behind_an_arm_has_its_own_actions() -> None:
    with served_sim(
        "dynamixel", "/with_gripper", GripperCommand, "gripper/gripper_cmd", ARMS["dynamixel"]
    ) as rig:
        engine = rig.session.children["gripper"]
        rig.enabled()
        engine.state_command("enable")
        eventually(lambda: engine.status.state is OperatingState.ENABLED, "the gripper is enabled")
        found = engine.feedback("measured_js")
        assert found is not None
        here = float(found[0].position[0])  # type: ignore[union-attr]
        (limit,) = engine.capabilities.limits
        there = here + (0.1 if here < 0.5 * (limit.lower + limit.upper) else -0.1) * (
            limit.upper - limit.lower
        )
        status, result = rig.asker.ask(grip(there)).wait()
        assert status == SUCCEEDED
        assert (result.stalled, result.reached_goal) == (False, True)
        assert result.position == pytest.approx(there, abs=0.02 * (limit.upper - limit.lower))


def test_without_the_messages_of_the_actions_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "crtk_drivers.ros.actions.grippers", None)
    session = Session(LOOPBACK, LoopbackConfig())
    with pytest.raises(ConfigError, match=r"node\.moveit") as error:
        Serving(session.engine, "/not_installed", (), MOVEIT)
    assert "crtk-drivers[moveit]" in error.value.remedy


def grip(position: float) -> GripperCommand.Goal:
    goal = GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = position, 0.0
    return goal


def parallel_grip(name: str, position: float) -> ParallelGripperCommand.Goal:
    goal = ParallelGripperCommand.Goal()
    goal.command.name, goal.command.position = [name], [position]
    return goal


def test_a_robotiq_gripper_closes_on_something_and_opens() -> None:
    with served_sim(
        "robotiq",
        "/gripped",
        GripperCommand,
        "gripper_cmd",
        {**PATIENT, "open_timeout": 10.0},
        object_width=0.03,
    ) as rig:
        rig.enabled()
        status, result = rig.asker.ask(grip(0.0)).wait()
        assert status == SUCCEEDED, "what is gripped is a success"
        assert (result.stalled, result.reached_goal) == (True, False)
        assert result.position == pytest.approx(0.03, abs=0.002)
        assert rig.asker.send(grip(float("nan"))) is None
        assert rig.asker.send(grip(0.5)) is None, "further than it opens"
        with ActionAsker(
            ParallelGripperCommand, "/gripped/parallel_gripper_cmd", "another"
        ) as other:
            assert other.send(parallel_grip("elbow", 0.08)) is None
            status, result = other.ask(parallel_grip("left_opening", 0.08)).wait()
        assert status == SUCCEEDED
        assert (result.stalled, result.reached_goal) == (False, True)
        assert list(result.state.name) == ["left_opening"]
        assert result.state.position[0] == pytest.approx(0.08, abs=0.002)
