"""The entry point of the grippers' driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_schunk.gripper.config import SchunkConfig
from crtk_driver_schunk.gripper.tools import TOOLS
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DevicePlugin, modbus_ways


def _create(config: SchunkConfig) -> Device:
    from crtk_driver_schunk.gripper.device import create

    return create(config)


def _sim_options(config: SchunkConfig) -> Mapping[str, Any]:
    return {
        "unit": config.address,
        "lower": config.lower,
        "upper": config.upper,
        "speed": config.speed,
        "max_force": config.max_force,
    }


def _at_tool(config: SchunkConfig, host: str) -> SchunkConfig:
    is_elsewhere = config.port or config.host
    return config if is_elsewhere else config.model_copy(update={"link": "tool", "host": host})


PLUGIN = DevicePlugin(
    name="schunk",
    summary="SCHUNK grippers EGU, EGK, EZU: their web server, Modbus RTU, robot's tool line",
    config=SchunkConfig,
    kind=DeviceKind.GRIPPER,
    create=_create,
    sim="schunk",
    extra="schunk",
    addresses=modbus_ways.ADDRESSES,
    check_real=modbus_ways.check_real,
    sim_config=modbus_ways.at_sim,
    sim_options=_sim_options,
    link=modbus_ways.LINK,
    at_tool=_at_tool,
    tool_line={"parity": "even"},
    tools=TOOLS,
)
