"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_haply.config import HaplyConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim


def _create(config: HaplyConfig) -> Device:
    from crtk_driver_haply.device import HaplyDevice

    return HaplyDevice(config)


def _at_sim(config: HaplyConfig, sim: RunningSim) -> HaplyConfig:
    return config.model_copy(update={"host": sim.host, "port": sim.ports["service"]})


def _sim_options(config: HaplyConfig) -> Mapping[str, Any]:
    told = {"device_id": config.device_id, "grip_id": config.grip_id}
    return {key: value for key, value in told.items() if value}


def _link(config: HaplyConfig, sim: RunningSim | None) -> DeviceLink:
    return DeviceLink(config.host, {"service": config.port})


def _at_link(config: HaplyConfig, link: DeviceLink) -> HaplyConfig:
    return config.model_copy(update={"host": link.host, "port": link.tcp["service"]})


PLUGIN = DevicePlugin(
    name="haply",
    summary="Haply Inverse3 with VerseGrip by Haply's Inverse service: pose, buttons, forces",
    config=HaplyConfig,
    kind=DeviceKind.HAPTIC,
    create=_create,
    sim="haply",
    extra="haply",
    addresses=("host", "port"),
    sim_config=_at_sim,
    sim_options=_sim_options,
    link=LinkAccess(_link, _at_link),
)
