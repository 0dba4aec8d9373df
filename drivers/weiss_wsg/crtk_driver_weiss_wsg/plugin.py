"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping

from crtk_driver_weiss_wsg.config import WsgConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim, SimFault

_PORTS: Mapping[str, str] = {"tcp": "binary", "text": "text"}
"""Port of the simulator, by link."""


def _create(config: WsgConfig) -> Device:
    from crtk_driver_weiss_wsg.device import create

    return create(config)


def _check_real(config: WsgConfig) -> None:
    key, example = ("port", "/dev/ttyUSB0") if config.link == "serial" else ("host", "192.168.1.20")
    if not getattr(config, key):
        raise ConfigError(
            f"{key}: is required for real hardware with link {config.link}",
            where="weiss-wsg",
            remedy=f"Give its address (--{key} {example}), or use --sim.",
        )


def _at_sim(config: WsgConfig, sim: RunningSim) -> WsgConfig:
    if config.link == "serial":
        return config.model_copy(update={"port": sim.ttys["serial"]})
    port = sim.ports[_PORTS[config.link]]
    return config.model_copy(update={"host": sim.host, "tcp_port": port})


def _link(config: WsgConfig, sim: RunningSim | None) -> DeviceLink | None:
    if config.link == "serial":
        return None
    return DeviceLink(config.host, {config.link: config.tcp_port})


def _at_link(config: WsgConfig, link: DeviceLink) -> WsgConfig:
    update = {"host": link.host, "tcp_port": link.tcp[config.link]}
    return config.model_copy(update=update)


def _at_tool(config: WsgConfig, host: str) -> WsgConfig:
    """It has an address of its own: nothing of the arm is needed."""
    if host and not (config.host or config.port):
        raise ConfigError(
            "gripper.settings.host: a WSG at an arm has an address of its own",
            where="weiss-wsg",
            remedy="Give it, or that of a simulated one: crtk-driver sim weiss-wsg.",
        )
    return config


PLUGIN = DevicePlugin(
    name="weiss-wsg",
    summary="Weiss Robotics (SCHUNK) WSG grippers: WSG 50, WSG 32; TCP (binary or text), serial",
    config=WsgConfig,
    kind=DeviceKind.GRIPPER,
    create=_create,
    sim="weiss-wsg",
    extra="weiss-wsg",
    addresses=("host", "port", "tcp_port"),
    check_real=_check_real,
    sim_config=_at_sim,
    sim_options=lambda config: {"model": config.model},
    sim_faults={SimFault.BLOCK: "part"},
    link=LinkAccess(_link, _at_link),
    at_tool=_at_tool,
)
