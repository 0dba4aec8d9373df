"""Partners that cannot work: another type, another quality of service, another ROS."""

from __future__ import annotations

import importlib.util
import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import TransformStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from crtk_drivers.errors import ConfigError, MissingExtra
from crtk_drivers.ros import environment
from rigs.loopback_node import Rig
from rigs.ros_client import RosClient
from rigs.waiting import eventually

BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


def logged(caplog: pytest.LogCaptureFixture, *words: str) -> bool:
    return any(all(word in r.getMessage() for word in words) for r in caplog.records)


def test_another_type_is_reported_once(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    topic = f"{rig.client.namespace}/servo_cp"
    with caplog.at_level(logging.WARNING), RosClient("/old") as old:
        old.node.create_publisher(TransformStamped, topic, 10)
        words = (topic, "TransformStamped", "PoseStamped")
        eventually(lambda: logged(caplog, *words), "the log names topic and types")
    assert sum(topic in r.getMessage() for r in caplog.records) == 1


def test_best_effort_commands_are_reported(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        topic = f"{rig.client.namespace}/servo_jp"
        publisher = rig.client.node.create_publisher(JointState, topic, BEST_EFFORT)
        eventually(lambda: logged(caplog, "servo_jp", "reliability"), "the log names the policy")
        rig.client.node.destroy_publisher(publisher)


def test_warnings_are_on_rosout(rig: Rig) -> None:
    from rcl_interfaces.msg import Log

    heard: list[Log] = []
    listener = rig.client.node.create_subscription(Log, "/rosout", heard.append, 10)

    def told() -> Log | None:
        logging.getLogger("crtk_drivers.test").warning("a word to all")
        return next((log for log in heard if log.msg == "a word to all"), None)

    assert eventually(told, "the warning arrives").name.endswith("crtk_driver")
    rig.client.node.destroy_subscription(listener)


def test_environment_is_accepted_as_it_is_here() -> None:
    environment.check()


def test_missing_ros_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(environment, "find_spec", lambda n: None if n == "rclpy" else found(n))
    with pytest.raises(MissingExtra) as caught:
        environment.check()
    assert "pip install 'crtk-drivers[ros]'" in caught.value.remedy


@pytest.mark.skipif(not environment.wheels_installed(), reason="a sourced ROS 2 may have others")
def test_another_middleware_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    with pytest.raises(ConfigError) as caught:
        environment.check()
    assert "unset RMW_IMPLEMENTATION" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not environment.wheels_installed(), reason="a sourced ROS 2 may have it")
def test_security_that_the_wheels_lack_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    with pytest.raises(ConfigError, match="built without security"):
        environment.check()


@pytest.mark.skipif(not environment.wheels_installed(), reason="needs the rclpy wheels")
def test_wheels_beside_a_sourced_ros_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    package = tmp_path / "rclpy"
    package.mkdir()
    (package / "__init__.py").touch()
    found = importlib.util.find_spec

    def sourced(name: str) -> Any:
        if name != "rclpy":
            return found(name)
        return importlib.util.spec_from_file_location(name, package / "__init__.py")

    monkeypatch.setattr(environment, "find_spec", sourced)
    with pytest.raises(ConfigError, match="mixed at random"):
        environment.check()


@pytest.mark.skipif(not environment.wheels_installed(), reason="needs the rclpy wheels")
def test_wheels_outside_an_environment_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """`pip install --user` puts rclpy and its wheel into one folder, which is not that of Python."""
    package = tmp_path / "rclpy"
    package.mkdir()
    (package / "__init__.py").touch()
    about = tmp_path / "ros_rclpy-7.1.1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: ros-rclpy\nVersion: 7.1.1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    found = importlib.util.find_spec
    spec = importlib.util.spec_from_file_location("rclpy", package / "__init__.py")
    monkeypatch.setattr(environment, "find_spec", lambda n: spec if n == "rclpy" else found(n))
    with pytest.raises(ConfigError, match=r"pip install --user") as caught:
        environment.check()
    assert "venv" in caught.value.remedy
    assert str(tmp_path) in str(caught.value)
    assert "sourced" not in str(caught.value)


def test_the_core_does_without_ros() -> None:
    """Nothing outside `crtk_drivers.ros` imports rclpy, nor do its `environment` and `names`."""
    modules = (
        "crtk_drivers, crtk_drivers.session, crtk_drivers.ros.environment, crtk_drivers.ros.names"
    )
    code = f"import sys, {modules}; sys.exit('rclpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
