"""my_sensor as a CRTK device."""

from __future__ import annotations

from crtk_drivers.plugins import DevicePlugin, RunningSim, required

from crtk_driver_my_sensor.config import MySensorConfig
from crtk_driver_my_sensor.device import MySensorDevice


def _at_sim(config: MySensorConfig, sim: RunningSim) -> MySensorConfig:
    return config.model_copy(update={"host": sim.host, "port": sim.ports["line"]})


PLUGIN = DevicePlugin(
    name="my_sensor",
    summary="my_sensor, a force sensor",
    config=MySensorConfig,
    create=MySensorDevice,
    sim="my_sensor",
    addresses=("host", "port"),
    check_real=required("host", "192.168.1.20"),
    sim_config=_at_sim,
)
