"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_robotiq.config import RobotiqConfig
from crtk_driver_robotiq.finding import GRIPPERS
from crtk_driver_robotiq.tools import TOOLS
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DevicePlugin, SimFault, modbus_ways


def _create(config: RobotiqConfig) -> Device:
    from crtk_driver_robotiq.device import create

    return create(config)


def _sim_options(config: RobotiqConfig) -> Mapping[str, Any]:
    unit = "controller_unit" if config.link == "controller" else "unit"
    return {
        "model": config.model,
        unit: config.address,
        "band_open": float(config.open_count),
        "band_closed": float(config.closed_count),
    }


PLUGIN = DevicePlugin(
    name="robotiq",
    summary="Robotiq grippers: 2F-85, 2F-140, Hand-E; serial, robot's tool line, Modbus TCP, URCap",
    config=RobotiqConfig,
    kind=DeviceKind.GRIPPER,
    create=_create,
    sim="robotiq",
    extra="robotiq",
    addresses=modbus_ways.ADDRESSES,
    check_real=modbus_ways.check_real,
    sim_config=modbus_ways.at_sim,
    sim_options=_sim_options,
    sim_faults={SimFault.BLOCK: "object"},
    link=modbus_ways.LINK,
    at_tool=modbus_ways.at_tool,
    finder=GRIPPERS,
    tools=TOOLS,
)
