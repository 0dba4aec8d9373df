"""my_gripper as a CRTK device."""

from __future__ import annotations

from crtk_drivers.plugins import DevicePlugin, required

from crtk_driver_my_gripper.config import MyGripperConfig
from crtk_driver_my_gripper.device import create

PLUGIN = DevicePlugin(
    name="my_gripper",
    summary="my_gripper, two fingers at a serial line",
    config=MyGripperConfig,
    create=create,
    sim="my_gripper",
    addresses=("port",),
    check_real=required("port", "/dev/ttyUSB0"),
    sim_config=lambda config, sim: config.model_copy(update={"port": sim.ttys["line"]}),
)
