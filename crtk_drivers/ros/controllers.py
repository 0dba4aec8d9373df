"""What a device serves as controllers of ros2_controllers would. No ROS here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from crtk_drivers.device import Device
from crtk_drivers.device.offered import follows_trajectories, offered

FOLLOW: Final = "follow_joint_trajectory"
GRIP: Final = "gripper_cmd"
PARALLEL_GRIP: Final = "parallel_gripper_cmd"

ACTION_TYPES: Final[Mapping[str, str]] = MappingProxyType(
    {
        FOLLOW: "FollowJointTrajectory",
        GRIP: "GripperCommand",
        PARALLEL_GRIP: "ParallelGripperCommand",
    }
)
"""The type of each action, of control_msgs; moveit_simple_controller_manager calls them so."""

SERVICES: Final = ("send_goal", "cancel_goal", "get_result")
TOPICS: Final = ("feedback", "status")
"""What an action is made of."""

TRAJECTORY: Final = "joint_trajectory"
"""Topic of joint_trajectory_controller."""

FORWARDS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "forward_position_controller/commands": "servo_jp",
        "forward_velocity_controller/commands": "servo_jv",
    }
)
"""Topics of forward_command_controllers, by the names that they have with a UR, and what they stand for."""


def actions_of(device: Device) -> tuple[str, ...]:
    """Return the actions of a device: a gripper is what has one joint that goes where it is sent."""
    found = [FOLLOW] if follows_trajectories(device) else []
    if len(device.capabilities.joints) == 1 and "move_jp" in offered(device):
        found += [GRIP, PARALLEL_GRIP]
    return tuple(found)


def inputs_of(device: Device) -> tuple[str, ...]:
    """Return the topics that a device takes in place of controllers."""
    commands = offered(device)
    found = [topic for topic, command in FORWARDS.items() if command in commands]
    return (*([TRAJECTORY] if follows_trajectories(device) else []), *found)


def part(action: str, name: str) -> str:
    """Return the name of a service or topic that an action is made of."""
    return f"{action}/_action/{name}"
