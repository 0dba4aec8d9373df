"""my_sensor as a CRTK device."""

from __future__ import annotations

from crtk_drivers.plugins import DevicePlugin, required

from crtk_driver_my_sensor.config import MySensorConfig
from crtk_driver_my_sensor.device import MySensorDevice

PLUGIN = DevicePlugin(
    name="my_sensor",
    summary="my_sensor, a force sensor at a serial line",
    config=MySensorConfig,
    create=MySensorDevice,
    sim="my_sensor",
    addresses=("port",),
    check_real=required("port", "/dev/ttyUSB0"),
    sim_config=lambda config, sim: config.model_copy(update={"port": sim.ttys["line"]}),
)
