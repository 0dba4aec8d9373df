"""The entry point of the driver."""

from __future__ import annotations

from crtk_driver_raven.config import RavenConfig
from crtk_drivers.device import Device
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim, required


def _create(config: RavenConfig) -> Device:
    from crtk_driver_raven.device import RavenDevice

    return RavenDevice(config)


def _at_sim(config: RavenConfig, sim: RunningSim) -> RavenConfig:
    return config.model_copy(update={"host": sim.host, "port": sim.ports["itp"]})


def _link(config: RavenConfig, sim: RunningSim | None) -> DeviceLink:
    return DeviceLink(config.host, udp={"itp": config.port})


def _at_link(config: RavenConfig, link: DeviceLink) -> RavenConfig:
    return config.model_copy(update={"host": link.host, "port": link.udp["itp"]})


PLUGIN = DevicePlugin(
    name="raven",
    summary="Raven II by its teleoperation packets: one way, increments of both arms and jaws",
    config=RavenConfig,
    create=_create,
    sim="raven",
    addresses=("host", "port"),
    check_real=required("host", "192.168.0.10"),
    sim_config=_at_sim,
    link=LinkAccess(_link, _at_link),
)
