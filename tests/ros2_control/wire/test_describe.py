"""What a robot has, told to people and written as a configuration that works."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from crtk_driver_ros2_control import PLUGIN
from crtk_driver_ros2_control.controllers import Controller, Role
from crtk_driver_ros2_control.tools import TOOLS
from crtk_driver_ros2_control.written import configuration_of, roles_in, text_of, untimed_in
from crtk_drivers.device import Mode
from crtk_drivers.errors import ConfigError, ConnectionFailed
from crtk_sim_backends.process import RunningSim
from crtk_sim_backends.ros2_control import SIM
from crtk_sim_backends.ros2_control.description import urdf_of
from crtk_sim_backends.ros2_control.joints import JointLimits
from rigs.ros2_control_bench import configuration

pytestmark = pytest.mark.ros
(DESCRIBE,) = TOOLS


@pytest.fixture(scope="module")
def robot() -> Iterator[RunningSim]:
    with SIM.spawn() as sim:
        yield sim


def test_the_configuration_that_is_written_makes_the_device(
    robot: RunningSim, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = DESCRIBE.options(folder=str(tmp_path))  # type: ignore[call-arg]
    assert DESCRIBE.run(configuration(robot), options) == 0
    told = capsys.readouterr().out
    assert "position_controller: joint_1" in told
    assert "admittance_controller: inactive" in told
    written = PLUGIN.load_config(tmp_path / "robot.yaml", {})
    device = PLUGIN.make(written)
    assert device.kinematics is not None
    assert device.capabilities.joints == tuple(f"joint_{n}" for n in range(1, 7))
    assert device.capabilities.limits[0].velocity == 1.5
    assert "left out: velocity_controller, forward_velocity_controller" in told
    assert device.capabilities.modes == {Mode.JOINT_POSITION}


def test_where_nobody_answers_it_says_so() -> None:
    config = PLUGIN.config(controller_manager="/nobody/controller_manager", open_timeout=0.3)  # type: ignore[call-arg]
    with pytest.raises(ConnectionFailed, match="list_controllers"):
        DESCRIBE.run(config, DESCRIBE.options())


def controller(name: str, kind: str, *joints: str, of: str = "") -> Controller:
    return Controller(name, "inactive", of, frozenset(), frozenset(f"{j}/{kind}" for j in joints))


def test_a_gripper_has_no_role_and_the_first_of_two_counts() -> None:
    controllers = {
        one.name: one
        for one in (
            controller("grip", "position", "finger"),
            controller("scaled", "position", "a", "b", of="ur/ScaledJointTrajectoryController"),
            controller("plain", "position", "a", "b", of="joint/JointTrajectoryController"),
            controller("forward", "position", "a", "b"),
        )
    }
    orders = {"forward": ("b", "a"), "grip": ("finger",)}
    found = roles_in(controllers, orders)
    assert found == {Role.TRAJECTORY: "scaled", Role.POSITION: "forward"}
    assert roles_in({}, {}) == {}


def test_without_a_description_joints_are_written_by_name() -> None:
    values = configuration_of("/cm", {Role.POSITION: "p"}, ("a", "b"), "", "x.urdf")
    assert yaml.safe_load(yaml.safe_dump(values)) == {
        "controller_manager": "/cm",
        "position_controller": "p",
        "joints": [{"name": "a"}, {"name": "b"}],
    }


@pytest.mark.parametrize("others", [{}, {Role.POSITION: "p"}])
def test_controllers_without_a_timeout_are_written_as_comments_that_say_why(
    tmp_path: Path, others: dict[Role, str]
) -> None:
    """A robot that has no others: as it is, its configuration is refused, and it says so."""
    roles = {**others, Role.VELOCITY: "v", Role.EFFORT: "e"}
    told = text_of(configuration_of("/cm", roles, ("a",), "", "x.urdf"), untimed_in(roles))
    assert ("is refused at start" in told) is not others
    path = tmp_path / "robot.yaml"
    path.write_text(told)
    as_it_is = PLUGIN.load_config(path, {})
    assert not as_it_is.allow_untimed
    if not others:
        with pytest.raises(ConfigError, match="no controller"):
            PLUGIN.make(as_it_is)
    for key in ("allow_untimed", "velocity_controller", "effort_controller"):
        told = told.replace(f"# {key}", key)
    path.write_text(told)
    with_them = PLUGIN.make(PLUGIN.load_config(path, {}))
    assert {Mode.JOINT_VELOCITY, Mode.JOINT_EFFORT} <= with_them.capabilities.modes


def test_an_answer_that_is_lost_is_asked_for_again(
    robot: RunningSim, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first to a client that the other side has not found yet."""
    # Two answers of each of seven services are lost: it need not wait for each as long as for a real robot.
    monkeypatch.setattr("crtk_driver_ros2_control.foreign.survey.AGAIN", 0.05)
    robot.control.inject("lost_answers", count=2)
    try:
        assert DESCRIBE.run(configuration(robot), DESCRIBE.options()) == 0  # type: ignore[call-arg]
    finally:
        robot.control.clear()
    assert "position_controller: joint_1" in capsys.readouterr().out


def test_joints_in_between_that_nobody_moves_make_a_table_of_limits() -> None:
    urdf = urdf_of(tuple(JointLimits(name) for name in ("lift", "a", "b")))
    values = configuration_of("/cm", {Role.POSITION: "p"}, ("a", "b"), urdf, "x.urdf")
    assert values["joints"][0] == {
        "name": "a",
        "lower": -3.0,
        "upper": 3.0,
        "velocity": 1.5,
        "effort": 40.0,
    }
    assert "urdf" not in values
