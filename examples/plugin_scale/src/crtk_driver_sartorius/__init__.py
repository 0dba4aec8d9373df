"""A Sartorius scale as a CRTK device: the smallest example of a plugin of crtk-drivers."""

from crtk_driver_sartorius.config import SartoriusConfig
from crtk_driver_sartorius.device import SartoriusDevice
from crtk_drivers.plugins import DevicePlugin, required

PLUGIN = DevicePlugin(
    name="sartorius",
    summary="a Sartorius scale at a serial line (example of a plugin)",
    config=SartoriusConfig,
    create=SartoriusDevice,
    sim="sartorius",
    addresses=("port",),
    check_real=required("port", "/dev/ttyUSB0"),
    sim_config=lambda config, sim: config.model_copy(update={"port": sim.ttys["line"]}),
)
