"""my_sensor as a CRTK device."""

from __future__ import annotations

from crtk_drivers.plugins import DevicePlugin, RunningSim, required

from crtk_driver_my_sensor.config import MySensorConfig
from crtk_driver_my_sensor.device import MySensorDevice


def _at_sim(config: MySensorConfig, sim: RunningSim) -> MySensorConfig:
    return config.model_copy(update={"port": sim.ttys["line"]})


PLUGIN = DevicePlugin(
    name="my_sensor",
    summary="my_sensor, a force sensor",
    config=MySensorConfig,
    create=MySensorDevice,
    sim="my_sensor",
    addresses=("port",),
    check_real=required("port", "/dev/ttyUSB0"),
    sim_config=_at_sim,
)
