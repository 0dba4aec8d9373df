"""The entry point of the driver."""

from __future__ import annotations

from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.device import NetFtDevice
from crtk_driver_ati_netft.tools import TOOLS
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import DevicePlugin


def _require_host(config: NetFtConfig) -> None:
    if not config.host:
        raise ConfigError(
            "host: is required for a real sensor",
            where="ati-netft",
            remedy="Give the sensor's address: --host 192.168.1.1",
        )


PLUGIN = DevicePlugin(
    name="ati-netft",
    summary="ATI NetFT force/torque sensors: Net Box, Ethernet Axia, SCHUNK FTN, OnRobot HEX",
    config=NetFtConfig,
    create=NetFtDevice,
    extra="ati-netft",
    check_real=_require_host,
    tools=TOOLS,
)
