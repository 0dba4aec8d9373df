"""Which controllers suit a role, and what one switch changes."""

from typing import Any

import pytest

from crtk_driver_ros2_control import PLUGIN
from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_driver_ros2_control.controllers import (
    Controller,
    Role,
    Switch,
    misfit,
    roles_of,
    switch_to,
    ways_of,
)
from crtk_drivers.device import Mode
from crtk_drivers.errors import ConfigError

JOINTS = ("a", "b")


def controller(name: str, kind: str, state: str = "inactive", *joints: str) -> Controller:
    needs = frozenset(f"{joint}/{kind}" for joint in joints or JOINTS)
    return Controller(name, state, "", needs if state == "active" else frozenset(), needs)


def test_one_switch_activates_and_deactivates_what_has_the_joints() -> None:
    listed = {
        "p": controller("p", "position", "active"),
        "v": controller("v", "velocity"),
        "gripper": controller("gripper", "position", "active", "finger"),
        "other": controller("other", "position", "active", "b"),
    }
    switch, foreign = switch_to("v", listed, ["p", "v"], JOINTS)
    assert switch == Switch(("v",), ("p", "other"))
    assert foreign == ("other",)


def test_what_is_active_already_needs_no_switch() -> None:
    listed = {"p": controller("p", "position", "active"), "v": controller("v", "velocity")}
    switch, _ = switch_to("p", listed, ["p", "v"], JOINTS)
    assert switch.is_empty


@pytest.mark.parametrize(
    ("role", "found", "words"),
    [
        (Role.POSITION, controller("x", "velocity"), "a/velocity"),
        (Role.POSITION, controller("x", "position", "inactive", "a"), "not a/position, b/position"),
        (
            Role.TRAJECTORY,
            controller("x", "position", "inactive", "a", "c"),
            "moves a, c, not a, b",
        ),
    ],
)
def test_a_controller_of_other_interfaces_has_no_role(
    role: Role, found: Controller, words: str
) -> None:
    assert words in misfit(role, found, JOINTS)


def test_a_controller_that_suits_its_role_has_one() -> None:
    assert misfit(Role.VELOCITY, controller("x", "velocity", "active"), JOINTS) == ""
    assert misfit(Role.TRAJECTORY, controller("x", "velocity"), JOINTS) == ""
    assert (
        misfit(Role.EFFORT, Controller("x", "unconfigured", "", frozenset(), frozenset()), JOINTS)
        == ""
    )


def config(**values: Any) -> Ros2ControlConfig:
    joints = [{"name": name} for name in JOINTS]
    return Ros2ControlConfig(joints=joints, **{"allow_untimed": True, **values})


def test_modes_follow_from_the_controllers() -> None:
    both = config(position_controller="p", trajectory_controller="t", velocity_controller="v")
    ways = ways_of(roles_of(both))
    assert ways == {Mode.JOINT_POSITION: Role.POSITION, Mode.JOINT_VELOCITY: Role.VELOCITY}
    assert not both.moves_by_goal
    alone = config(trajectory_controller="t")
    assert ways_of(roles_of(alone)) == {Mode.JOINT_POSITION: Role.TRAJECTORY}
    assert alone.moves_by_goal
    assert not config(trajectory_controller="t", moves="core").moves_by_goal


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"position_controller": "p", "velocity_controller": "p"}, "named twice"),
        ({"velocity_controller": "v", "allow_untimed": False}, "v: forward .* have no timeout"),
        ({"effort_controller": "f", "allow_untimed": False}, "allow_untimed: true"),
        ({"moves": "trajectory", "position_controller": "p"}, "trajectory_controller"),
        ({"on_disable": "hardware", "position_controller": "p"}, "hardware"),
        ({"urdf": "x.urdf"}, "not both"),
        ({"position_controller": "p/../q"}, "pattern"),
        ({"controller_manager": "manager"}, "pattern"),
        ({"domain": 233}, "232"),
    ],
)
def test_what_contradicts_itself_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        config(**values)


@pytest.mark.parametrize(
    "joints", [[{"name": "a"}, {"name": "a"}], [{"name": "a", "lower": 1.0, "upper": 1.0}]]
)
def test_joints_with_one_name_or_no_range_are_refused(joints: list[dict[str, Any]]) -> None:
    with pytest.raises(ValueError, match="a is"):
        Ros2ControlConfig(joints=joints)


@pytest.mark.ros
@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"controller_manager": "/m", "position_controller": "p"}, "there are no joints"),
        ({"controller_manager": "/m", "joints": [{"name": "a"}]}, "no controller"),
        ({"urdf": "/nowhere.urdf", "position_controller": "p"}, "nowhere.urdf"),
    ],
)
def test_a_device_needs_joints_and_a_controller(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        PLUGIN.create(Ros2ControlConfig(**values))


def test_what_stays_when_the_driver_dies_is_declared() -> None:
    device = PLUGIN.create(config(velocity_controller="v", position_controller="p"))
    stop = device.capabilities.stop
    assert "GO ON at the last velocity" in stop.description
    assert stop.link_timeout > 1e6
    device = PLUGIN.create(config(position_controller="p"))
    assert "GO ON" not in device.capabilities.stop.description


@pytest.mark.ros
def test_two_robots_behind_one_manager_have_threads_of_their_own() -> None:
    left, right = (
        PLUGIN.create(
            Ros2ControlConfig(
                controller_manager="/m", joints=[{"name": name}], position_controller=f"p_{name}"
            )
        )
        for name in JOINTS
    )
    assert left.address == right.address
    assert left.bus != right.bus
