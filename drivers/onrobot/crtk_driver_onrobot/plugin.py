"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_onrobot.config import OnRobotConfig
from crtk_driver_onrobot.tools import TOOLS
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.kit.gripping import GripperDevice
from crtk_drivers.plugins import DevicePlugin, SimFault, modbus_ways


def _create(config: OnRobotConfig) -> Device:
    from crtk_driver_onrobot.fingers import SETTLING, FingerHand
    from crtk_driver_onrobot.models import Fingers
    from crtk_driver_onrobot.vacuum import VacuumHand

    hand = (FingerHand if isinstance(config.tool, Fingers) else VacuumHand)(config)
    return GripperDevice(hand, config.place, config.on_close, SETTLING)


def _sim_options(config: OnRobotConfig) -> Mapping[str, Any]:
    return {"model": config.model, "unit": config.address}


PLUGIN = DevicePlugin(
    name="onrobot",
    summary="OnRobot grippers: RG2, RG6, 2FG7, 2FG14, 3FG15, VG10, VGC10; Compute Box, serial, tool line",
    config=OnRobotConfig,
    kind=DeviceKind.GRIPPER,
    create=_create,
    sim="onrobot",
    extra="onrobot",
    addresses=modbus_ways.ADDRESSES,
    check_real=modbus_ways.check_real,
    sim_config=modbus_ways.at_sim,
    sim_options=_sim_options,
    sim_faults={SimFault.BLOCK: "object"},
    link=modbus_ways.LINK,
    at_tool=modbus_ways.at_tool,
    tool_line={"baud": 1_000_000, "parity": "even"},
    tools=TOOLS,
)
