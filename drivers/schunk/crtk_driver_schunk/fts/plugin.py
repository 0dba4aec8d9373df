"""The entry point of the force sensors' driver."""

from __future__ import annotations

from crtk_driver_schunk.fts.config import FtsConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DeviceLink, DevicePlugin, RunningSim, required
from crtk_drivers.samples import Wrench


def _create(config: FtsConfig) -> Device:
    from crtk_driver_schunk.fts.device import FtsDevice

    return FtsDevice(config)


def _at_sim(config: FtsConfig, sim: RunningSim) -> FtsConfig:
    # Of several simulated sensors each has a port of this machine.
    return config.model_copy(update={"host": sim.host, "tcp_port": sim.ports["tcp"], "udp_port": 0})


def _load(sim: RunningSim, wrench: Wrench) -> None:
    sim.control.call("carry", wrench=wrench.vector.tolist())


def _link(config: FtsConfig, sim: RunningSim | None) -> DeviceLink:
    return DeviceLink(config.host, {"tcp": config.tcp_port})


def _at_link(config: FtsConfig, link: DeviceLink) -> FtsConfig:
    return config.model_copy(update={"host": link.host, "tcp_port": link.tcp["tcp"]})


PLUGIN = DevicePlugin(
    name="schunk-fts",
    summary="SCHUNK force/torque sensors FTS at their Ethernet box",
    config=FtsConfig,
    kind=DeviceKind.FORCE_SENSOR,
    create=_create,
    sim="schunk-fts",
    addresses=("host", "tcp_port", "udp_port"),
    check_real=required("host", "192.168.0.100"),
    sim_config=_at_sim,
    sim_load=_load,
)
