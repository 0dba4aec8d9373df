"""A linear stage as a CRTK device: the worked example of a plugin of crtk-drivers."""

from __future__ import annotations

from crtk_driver_one_axis.config import OneAxisConfig
from crtk_driver_one_axis.device import OneAxisDevice
from crtk_drivers.plugins import DevicePlugin, RunningSim, required


def _at_sim(config: OneAxisConfig, sim: RunningSim) -> OneAxisConfig:
    return config.model_copy(update={"host": sim.host, "port": sim.ports["stage"]})


PLUGIN = DevicePlugin(
    name="one_axis",
    summary="a linear stage with a line protocol over TCP (example of a plugin)",
    config=OneAxisConfig,
    create=OneAxisDevice,
    sim="one_axis",
    addresses=("host", "port"),
    check_real=required("host", "192.168.1.20"),
    sim_config=_at_sim,
    sim_options=lambda config: {"travel": config.travel},
)
