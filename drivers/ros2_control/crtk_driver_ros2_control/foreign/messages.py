"""ROS messages from plain data and back: of controller_manager, parameters, and trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from action_msgs.srv import CancelGoal
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from controller_manager_msgs.srv import (
    ListControllers,
    ListHardwareComponents,
    SetHardwareComponentState,
    SwitchController,
)
from lifecycle_msgs.msg import State
from rcl_interfaces.srv import GetParameters
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from crtk_driver_ros2_control.asking import Told
from crtk_driver_ros2_control.controllers import Component, Controller
from crtk_drivers.recording import cdr
from crtk_drivers.ros.plain import fill_plain
from crtk_drivers.samples import Numbers

LIST_CONTROLLERS: Final = ListControllers
LIST_HARDWARE: Final = ListHardwareComponents
SET_HARDWARE: Final = SetHardwareComponentState
SWITCH: Final = SwitchController
CANCEL: Final = CancelGoal
"""Without a goal and a time it is for all goals."""
PARAMETERS: Final = GetParameters

STATES: Final[Mapping[str, int]] = {
    "unconfigured": State.PRIMARY_STATE_UNCONFIGURED,
    "inactive": State.PRIMARY_STATE_INACTIVE,
    "active": State.PRIMARY_STATE_ACTIVE,
    "finalized": State.PRIMARY_STATE_FINALIZED,
}
"""Primary states of a life cycle, with the numbers of lifecycle_msgs."""

_NAMES: Final = {number: name for name, number in STATES.items()}


def request(kind: Any, fields: Mapping[str, Any]) -> Any:
    """Return a request with these fields."""
    made = kind.Request()
    fill_plain(made, fields)
    return made


def switching(
    activate: Sequence[str], deactivate: Sequence[str], timeout: float
) -> Mapping[str, Any]:
    """Return the fields of a STRICT switch."""
    seconds, rest = divmod(timeout, 1.0)
    return {
        "activate_controllers": list(activate),
        "deactivate_controllers": list(deactivate),
        "strictness": SwitchController.Request.STRICT,
        "timeout": {"sec": int(seconds), "nanosec": int(rest * 1e9)},
    }


def bringing(component: str, state: str) -> Mapping[str, Any]:
    """Return the fields that bring a hardware component into a state."""
    return {"name": component, "target_state": {"id": STATES[state], "label": state}}


def controllers(answer: Any) -> dict[str, Controller]:
    """Read list_controllers: by name."""
    return {
        one.name: Controller(
            one.name,
            one.state,
            one.type,
            frozenset(one.claimed_interfaces),
            frozenset(one.required_command_interfaces),
        )
        for one in answer.controller
    }


def components(answer: Any) -> dict[str, Component]:
    """Read list_hardware_components: by name."""
    return {
        one.name: Component(one.name, _NAMES.get(one.state.id, one.state.label))
        for one in answer.component
    }


def told_of_switch(answer: Any) -> Told:
    """Read what switch_controller says."""
    return Told(bool(answer.ok), str(answer.message))


def told_of_cancel(answer: Any) -> Told:
    """Read what cancel_goal says: whether any goal is being given up."""
    return Told(bool(answer.goals_canceling), "")


def told_of_hardware(answer: Any) -> Told:
    """Read what set_hardware_component_state says: its text is the state."""
    return Told(bool(answer.ok), _NAMES.get(answer.state.id, str(answer.state.label)))


def texts(answer: Any) -> tuple[str, ...]:
    """Read a parameter that is a list of texts; empty if it is none."""
    return tuple(answer.values[0].string_array_value) if answer.values else ()


def command(values: Sequence[float]) -> bytes:
    """Return a Float64MultiArray."""
    return cdr.encode(Numbers(tuple(float(value) for value in values)), 0)


def _trajectory(
    joints: Sequence[str], positions: Sequence[float], seconds: float
) -> JointTrajectory:
    whole, rest = divmod(seconds, 1.0)
    point = JointTrajectoryPoint(
        positions=[float(position) for position in positions],
        time_from_start=Duration(sec=int(whole), nanosec=int(rest * 1e9)),
    )
    return JointTrajectory(joint_names=list(joints), points=[point])


def one_point(joints: Sequence[str], positions: Sequence[float], seconds: float) -> bytes:
    """Return a JointTrajectory that begins at once, with positions alone: the controller's way is linear."""
    made: bytes = serialize_message(_trajectory(joints, positions, seconds))
    return made


def goal(joints: Sequence[str], positions: Sequence[float], seconds: float) -> Any:
    """Return a goal that begins at once and ends at rest: the controller's way is cubic."""
    trajectory = _trajectory(joints, positions, seconds)
    trajectory.points[0].velocities = [0.0] * len(joints)
    return FollowJointTrajectory.Goal(trajectory=trajectory)
