"""A device behind a device on ROS: a namespace of its own, reached through the client of the device."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from crtk_drivers.client import connect
from crtk_drivers.device import Device
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_node import serve, until
from rigs.ros_client import TIMEOUT


class WithGripper(LoopbackDevice):
    """A gantry that carries another one."""

    def __init__(self, config: LoopbackConfig | None = None) -> None:
        super().__init__(config)
        self.gripper = LoopbackDevice(config)

    @property
    def children(self) -> Mapping[str, Device]:
        return {"gripper": self.gripper}


PLUGIN = DevicePlugin("with-gripper", "A gantry with another one.", LoopbackConfig, WithGripper)


def test_it_is_moved_through_the_client_of_the_device() -> None:
    with (
        serve(LoopbackConfig(), "/children", [], plugin=PLUGIN) as (session, _),
        connect("/children", timeout=TIMEOUT) as arm,
    ):
        gripper = session.children["gripper"]
        until(lambda: gripper.connected, "the gripper is connected")
        arm.gripper.enable(TIMEOUT)
        arm.gripper.move_jp([0.02, 0.0, 0.0, 0.0]).wait(TIMEOUT)
        # One that was sent before the last cycle of the motion may still be on its way.
        until(
            lambda: arm.gripper.setpoint_js(wait=TIMEOUT).position[0] == pytest.approx(0.02),
            "the gripper's setpoint is the goal",
        )
        assert gripper.status.state == "ENABLED"
        assert session.engine.status.state == "DISABLED"


def test_two_devices_are_not_put_into_one_namespace() -> None:
    with (
        pytest.raises(ConfigError, match=r"put gripper into /elsewhere.*--ns"),
        serve(
            LoopbackConfig(), "/children", ["--ros-args", "-r", "__ns:=/elsewhere"], plugin=PLUGIN
        ),
    ):
        pass
