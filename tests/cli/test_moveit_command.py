"""``crtk-driver moveit``: what it prints is what moveit_simple_controller_manager reads."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from crtk_drivers.cli import main

UR_JOINTS = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
]


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> Any:
    assert main(["moveit", *arguments]) == 0
    content = yaml.safe_load(capsys.readouterr().out)
    manager = "moveit_simple_controller_manager"
    assert content["moveit_controller_manager"] == f"{manager}/MoveItSimpleControllerManager"
    found = content[manager]
    assert found["controller_names"] == [name for name in found if name != "controller_names"]
    for controller in found["controller_names"]:
        assert set(found[controller]) == {"type", "action_ns", "default", "joints"}
    return found


def test_an_arm_has_its_joints_and_the_action_of_its_namespace(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = printed(capsys, "ur", "--ns", "/lab/ur5", "--set", "node.joint_prefix=left_")
    assert found["controller_names"] == ["lab/ur5"]
    assert found["lab/ur5"] == {
        "type": "FollowJointTrajectory",
        "action_ns": "follow_joint_trajectory",
        "default": True,
        "joints": [f"left_{name}" for name in UR_JOINTS],
    }


def test_a_gripper_behind_an_arm_is_a_controller_of_its_own(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = printed(capsys, "ur", "--ns", "/ur5", "--gripper", "robotiq")
    assert found["controller_names"] == ["ur5", "ur5/gripper"]
    assert found["ur5/gripper"]["type"] == "GripperCommand"
    assert found["ur5/gripper"]["action_ns"] == "gripper_cmd"
    assert found["ur5/gripper"]["joints"] == ["opening"]


def test_without_a_namespace_the_action_stands_alone(capsys: pytest.CaptureFixture[str]) -> None:
    found = printed(capsys, "ur", "--ns", "/")
    assert found["controller_names"] == ["follow_joint_trajectory"]
    assert found["follow_joint_trajectory"]["action_ns"] == ""


def test_what_has_nothing_to_ask_of_has_no_controllers(capsys: pytest.CaptureFixture[str]) -> None:
    assert printed(capsys, "ati-netft")["controller_names"] == []
