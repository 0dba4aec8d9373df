"""my_arm as a CRTK device."""

from __future__ import annotations

from crtk_drivers.plugins import DevicePlugin, RunningSim, required

from crtk_driver_my_arm.config import MyArmConfig
from crtk_driver_my_arm.device import MyArmDevice


def _at_sim(config: MyArmConfig, sim: RunningSim) -> MyArmConfig:
    return config.model_copy(update={"host": sim.host, "port": sim.ports["arm"]})


PLUGIN = DevicePlugin(
    name="my_arm",
    summary="my_arm, an arm of three joints",
    config=MyArmConfig,
    create=MyArmDevice,
    sim="my_arm",
    addresses=("host", "port"),
    check_real=required("host", "192.168.1.20"),
    sim_config=_at_sim,
)
