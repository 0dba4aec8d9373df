"""A device behind a device: an engine of its own on the same bus, an attribute of the front."""

from collections.abc import Mapping

import numpy as np
import pytest

from crtk_drivers.device import Device
from crtk_drivers.front import LocalDevice
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import Pose, vector
from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from crtk_drivers.wrappers.base_frame import PlacedDevice
from rigs.waiting import LONG


class WithGripper(LoopbackDevice):
    """A gantry that carries another one."""

    def __init__(self, config: LoopbackConfig | None = None) -> None:
        super().__init__(config)
        self.gripper = LoopbackDevice(config)

    @property
    def children(self) -> Mapping[str, Device]:
        return {"gripper": self.gripper}


PLUGIN = DevicePlugin("with-gripper", "A gantry with another one.", LoopbackConfig, WithGripper)


def started() -> LocalDevice:
    session = Session(PLUGIN, LoopbackConfig())
    arm = LocalDevice(session)
    session.start()
    return arm


def test_it_has_a_state_and_motion_of_its_own() -> None:
    with started() as arm:
        gripper = arm.gripper
        assert gripper.wait_for_operating_state("DISABLED", 2.0)
        gripper.enable(2.0)
        gripper.move_jp(vector((0.01, 0.0, 0.0, 0.0))).wait(LONG)
        assert gripper.setpoint_js().position[0] == pytest.approx(0.01)
        assert arm.operating_state().state == "DISABLED"
        assert not arm.measured_js().position.any()
        assert not np.array_equal(gripper.measured_js().position, arm.measured_js().position)


def test_its_fault_leaves_the_device_alone() -> None:
    with started() as arm:
        assert arm.wait_for_operating_state("DISABLED", 2.0)
        arm.enable(2.0)
        child = arm.gripper.engine.device
        child.reachable = False
        assert arm.gripper.wait_for_operating_state("FAULT", 2.0)
        assert arm.is_enabled()


def test_both_share_one_thread_and_are_named_by_the_device() -> None:
    session = Session(PLUGIN, LoopbackConfig(name="portal"))
    assert [engine.name for engine in session.engines] == ["portal", "portal/gripper"]
    assert {engine.device.bus for engine in session.engines} == {"loopback"}


def test_a_wrapped_device_keeps_them() -> None:
    base = Pose(vector((0, 0, 1)), vector((0, 0, 0, 1)), "world")
    assert set(PlacedDevice(WithGripper(), base).children) == {"gripper"}


def test_a_device_without_says_nothing_of_them() -> None:
    assert dict(LoopbackDevice().children) == {}
