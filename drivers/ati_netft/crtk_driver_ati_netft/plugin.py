"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.device import NetFtDevice
from crtk_driver_ati_netft.tools import TOOLS
from crtk_drivers.device import DeviceKind
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim, required
from crtk_drivers.samples import Wrench

_PORTS = ("rdt", "tcp", "http")


def _at_sim(config: NetFtConfig, sim: RunningSim) -> NetFtConfig:
    ports = {f"{name}_port": number for name, number in sim.ports.items() if name in _PORTS}
    return config.model_copy(update={"host": sim.host, **ports})


def _sim_options(config: NetFtConfig) -> Mapping[str, Any]:
    return {} if config.profile == "auto" else {"profile": config.profile}


def _load(sim: RunningSim, wrench: Wrench) -> None:
    sim.control.call("carry", wrench=wrench.vector.tolist())


def _link(config: NetFtConfig, sim: RunningSim | None) -> DeviceLink:
    tcp = {"tcp": config.tcp_port, "http": config.http_port}
    return DeviceLink(config.host, tcp, {"rdt": config.rdt_port})


def _at_link(config: NetFtConfig, link: DeviceLink) -> NetFtConfig:
    ports = {f"{name}_port": port for name, port in (*link.tcp.items(), *link.udp.items())}
    return config.model_copy(update={"host": link.host, **ports})


PLUGIN = DevicePlugin(
    name="ati-netft",
    summary="ATI NetFT force/torque sensors: Net Box, Ethernet Axia, SCHUNK FTN, OnRobot HEX",
    config=NetFtConfig,
    kind=DeviceKind.FORCE_SENSOR,
    create=NetFtDevice,
    sim="ati-netft",
    extra="ati-netft",
    addresses=("host", "rdt_port", "tcp_port", "http_port"),
    check_real=required("host", "192.168.1.1"),
    sim_config=_at_sim,
    sim_options=_sim_options,
    sim_load=_load,
    tools=TOOLS,
    link=LinkAccess(_link, _at_link),
)
