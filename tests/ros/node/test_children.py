"""A device behind a device on ROS: a namespace of its own, reached through the client of the device."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String

from crtk_drivers.client import connect
from crtk_drivers.device import Device
from crtk_drivers.errors import ConfigError, ConnectionFailed
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros import qos
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_client import Node
from rigs.loopback_node import serve
from rigs.waiting import LONG, eventually


def test_what_the_manifest_tells_of_is_waited_for() -> None:
    """A device is known by its manifest; what is behind it may be found later."""
    manifest = {"name": "late", "commands": {}, "children": ["gripper"]}
    with Node("late_arm") as node:
        told = node.node.create_publisher(String, "/late/driver/crtk_capabilities", qos.LATCHED)
        told.publish(String(data=json.dumps(manifest)))
        with connect("/late", timeout=LONG) as arm:
            with pytest.raises(AttributeError, match="nothing in jaw"):
                arm.jaw  # noqa: B018 - asking is the test
            make = node.node.create_publisher
            later = threading.Timer(0.5, make, (JointState, "/late/gripper/measured_js", 10))
            later.start()
            assert list(arm.gripper.crtk_commands) == ["measured_js"]
            later.join()


def test_who_waits_for_it_keeps_nobody_from_the_device() -> None:
    hold = {"name": "/slow/hold", "type": "std_msgs/msg/Empty"}
    manifest = {"name": "slow", "commands": {"hold": hold}, "children": ["gripper"]}
    with Node("slow_arm") as node:
        held = threading.Event()
        node.node.create_subscription(Empty, "/slow/hold", lambda message: held.set(), 10)
        told = node.node.create_publisher(String, "/slow/driver/crtk_capabilities", qos.LATCHED)
        told.publish(String(data=json.dumps(manifest)))
        with connect("/slow", timeout=LONG) as arm, ThreadPoolExecutor() as pool:
            asked = threading.Event()
            found = pool.submit(lambda: (asked.set(), arm.child("gripper", timeout=LONG)))
            assert asked.wait(LONG)
            arm.hold()
            assert held.wait(LONG)
            assert not found.done(), "the device was held when the wait had ended"
            node.node.create_publisher(JointState, "/slow/gripper/measured_js", 10)
            assert list(found.result(LONG)[1].crtk_commands) == ["measured_js"]


def test_a_name_that_the_manifest_lacks_is_refused_at_once() -> None:
    ratio = {"name": "/told/trajectory_j/ratio_v", "type": "std_msgs/msg/Float64"}
    commands = {"trajectory_j/ratio_v": ratio}
    manifest = {"name": "told", "commands": commands, "children": ["gripper"]}
    with Node("told_arm") as node:
        told = node.node.create_publisher(String, "/told/driver/crtk_capabilities", qos.LATCHED)
        told.publish(String(data=json.dumps(manifest)))
        with connect("/told", timeout=LONG) as arm:
            begun = time.monotonic()
            with pytest.raises(ConnectionFailed) as caught:
                arm.child("griper")
            assert time.monotonic() - begun < LONG / 4
            assert str(caught.value) == (
                "/told: there is nothing in griper/. "
                "Did you mean gripper? There is: gripper, trajectory_j."
            )
            node.node.create_publisher(JointState, "/told/camera/measured_js", 10)
            eventually(lambda: "/told/camera/measured_js" in arm._space.link.topics(), "it is seen")
            assert list(arm.child("camera").crtk_commands) == ["measured_js"], "somebody else's"


def test_a_manifest_that_is_on_its_way_is_waited_for() -> None:
    with Node("slow_manifest") as node:
        told = node.node.create_publisher(String, "/coming/driver/crtk_capabilities", qos.LATCHED)
        node.node.create_publisher(JointState, "/coming/measured_js", 10)
        with connect("/coming", timeout=3.0) as arm, ThreadPoolExecutor() as pool:
            assert not arm.manifest
            found = pool.submit(arm.child, "griper", LONG)
            text = json.dumps({"name": "coming", "commands": {}, "children": ["gripper"]})
            told.publish(String(data=text))
            with pytest.raises(ConnectionFailed, match=r"Did you mean gripper\?"):
                found.result(LONG / 2)


class WithGripper(LoopbackDevice):
    """A gantry that carries another one."""

    def __init__(self, config: LoopbackConfig | None = None) -> None:
        super().__init__(config)
        self.gripper = LoopbackDevice(config)

    @property
    def children(self) -> Mapping[str, Device]:
        return {"gripper": self.gripper}


class WithJaw(LoopbackDevice):
    """A gantry that carries another one, as a dVRK arm its jaw."""

    def __init__(self, config: LoopbackConfig | None = None) -> None:
        super().__init__(config)
        self.jaw = LoopbackDevice(config)

    @property
    def children(self) -> Mapping[str, Device]:
        return {"jaw": self.jaw}

    @property
    def followers(self) -> frozenset[str]:
        return frozenset({"jaw"})


JAW = DevicePlugin("with-jaw", "A gantry with another one.", LoopbackConfig, WithJaw)
PLUGIN = DevicePlugin("with-gripper", "A gantry with another one.", LoopbackConfig, WithGripper)


def test_it_is_moved_through_the_client_of_the_device() -> None:
    with (
        serve(LoopbackConfig(), "/children", [], plugin=PLUGIN) as (session, _),
        connect("/children", timeout=LONG) as arm,
    ):
        gripper = session.children["gripper"]
        eventually(lambda: gripper.connected, "the gripper is connected")
        arm.gripper.enable(LONG)
        arm.gripper.move_jp([0.02, 0.0, 0.0, 0.0]).wait(LONG)
        # One that was sent before the last cycle of the motion may still be on its way.
        eventually(
            lambda: arm.gripper.setpoint_js(wait=LONG).position[0] == pytest.approx(0.02),
            "the gripper's setpoint is the goal",
        )
        assert gripper.status.state == "ENABLED"
        assert session.engine.status.state == "DISABLED"


def test_one_without_a_state_has_none_on_ros_and_its_moves_are_told_by_that_of_the_device() -> None:
    with (
        serve(LoopbackConfig(), "/psm", [], plugin=JAW) as (session, _),
        connect("/psm", timeout=LONG) as arm,
    ):
        jaw = session.children["jaw"]
        assert "state_command" not in arm.jaw.crtk_commands
        assert arm.manifest["followers"] == ["jaw"], "it has a manifest of its own"
        assert arm.jaw.manifest["commands"]["measured_js"]["name"] == "/psm/jaw/measured_js"
        arm.enable(LONG)
        eventually(lambda: jaw.status.state == "ENABLED", "the jaw is enabled")
        assert arm.jaw.operating_state().state == "ENABLED"
        arm.jaw.move_jp([0.02, 0.0, 0.0, 0.0]).wait(LONG)
        eventually(
            lambda: arm.jaw.setpoint_js(wait=LONG).position[0] == pytest.approx(0.02),
            "the jaw's setpoint is the goal",
        )
        link = arm._space.link
        there = {"/psm/operating_state", "/psm/jaw/measured_js"}
        eventually(lambda: there <= link.topics().keys(), "the topics are found")
        of_state = {"/psm/jaw/operating_state", "/psm/jaw/state_command"}
        assert not of_state & link.topics().keys()
        eventually(lambda: "/psm/jaw/crtk_version" in link.services(), "the service is found")
        assert "/psm/jaw/operating_state" not in link.services()


def test_two_devices_are_not_put_into_one_namespace() -> None:
    with (
        pytest.raises(ConfigError, match=r"put gripper into /elsewhere.*--ns"),
        serve(
            LoopbackConfig(), "/children", ["--ros-args", "-r", "__ns:=/elsewhere"], plugin=PLUGIN
        ),
    ):
        pass
