"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_robotiq.config import RobotiqConfig
from crtk_driver_robotiq.tools import TOOLS
from crtk_drivers.device import Device
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim


def _create(config: RobotiqConfig) -> Device:
    from crtk_driver_robotiq.device import RobotiqDevice

    return RobotiqDevice(config)


def _check_real(config: RobotiqConfig) -> None:
    key, example = ("port", "/dev/ttyUSB0") if config.link == "serial" else ("host", "192.168.1.10")
    if not getattr(config, key):
        raise ConfigError(
            f"{key}: is required for real hardware with link {config.link}",
            where="robotiq",
            remedy=f"Give its address (--{key} {example}), or use --sim.",
        )


def _at_sim(config: RobotiqConfig, sim: RunningSim) -> RobotiqConfig:
    if config.link == "serial":
        return config.model_copy(update={"port": sim.ttys["serial"]})
    return config.model_copy(update={"host": sim.host, "tcp_port": sim.ports[config.link]})


def _sim_options(config: RobotiqConfig) -> Mapping[str, Any]:
    return {
        "model": config.model,
        "unit": config.address,
        "band_open": float(config.open_count),
        "band_closed": float(config.closed_count),
    }


def _link(config: RobotiqConfig, sim: RunningSim | None) -> DeviceLink | None:
    if config.link == "serial":
        return None
    return DeviceLink(config.host, {config.link: config.number})


def _at_link(config: RobotiqConfig, link: DeviceLink) -> RobotiqConfig:
    update = {"host": link.host, "tcp_port": link.tcp[config.link]}
    return config.model_copy(update=update)


def _at_tool(config: RobotiqConfig, host: str) -> RobotiqConfig:
    if config.port or config.host:
        return config
    link = config.link if config.link == "urcap" else "tool"
    return config.model_copy(update={"link": link, "host": host})


PLUGIN = DevicePlugin(
    name="robotiq",
    summary="Robotiq grippers: 2F-85, 2F-140, Hand-E; serial, robot's tool line, Modbus TCP, URCap",
    config=RobotiqConfig,
    create=_create,
    sim="robotiq",
    extra="robotiq",
    addresses=("port", "host", "tcp_port"),
    check_real=_check_real,
    sim_config=_at_sim,
    sim_options=_sim_options,
    link=LinkAccess(_link, _at_link),
    at_tool=_at_tool,
    tools=TOOLS,
)
