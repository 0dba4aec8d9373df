"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_robotiq.ft300.config import Ft300Config
from crtk_driver_robotiq.ft300.finding import SENSORS
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DevicePlugin, RunningSim, modbus_ways
from crtk_drivers.samples import Wrench


def _create(config: Ft300Config) -> Device:
    from crtk_driver_robotiq.ft300.device import Ft300Device

    return Ft300Device(config)


def _sim_options(config: Ft300Config) -> Mapping[str, Any]:
    return {"unit": config.address, "baud": config.baud}


def _load(sim: RunningSim, wrench: Wrench) -> None:
    names = ("fx", "fy", "fz", "mx", "my", "mz")
    sim.control.inject("carry", **dict(zip(names, wrench.vector.tolist(), strict=True)))


PLUGIN = DevicePlugin(
    name="robotiq-ft300",
    summary="Robotiq force sensors: FT 300, FT 300-S; serial, robot's tool line, Modbus TCP",
    config=Ft300Config,
    kind=DeviceKind.FORCE_SENSOR,
    create=_create,
    sim="robotiq-ft300",
    finder=SENSORS,
    extra="robotiq",
    addresses=modbus_ways.ADDRESSES,
    check_real=modbus_ways.check_real,
    sim_config=modbus_ways.at_sim,
    sim_options=_sim_options,
    sim_load=_load,
    link=modbus_ways.LINK,
    at_tool=modbus_ways.at_tool,
    tool_line={"baud": 19_200},
)
