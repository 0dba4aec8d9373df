"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_robotiq.epick.config import EpickConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DevicePlugin, modbus_ways


def _create(config: EpickConfig) -> Device:
    from crtk_driver_robotiq.epick.device import create

    return create(config)


def _sim_options(config: EpickConfig) -> Mapping[str, Any]:
    return {"unit": config.address}


PLUGIN = DevicePlugin(
    name="robotiq-epick",
    summary="Robotiq vacuum gripper ePick; serial, robot's tool line, Modbus TCP",
    config=EpickConfig,
    kind=DeviceKind.GRIPPER,
    create=_create,
    sim="robotiq-epick",
    extra="robotiq",
    addresses=modbus_ways.ADDRESSES,
    check_real=modbus_ways.check_real,
    sim_config=modbus_ways.at_sim,
    sim_options=_sim_options,
    link=modbus_ways.LINK,
    at_tool=modbus_ways.at_tool,
)
