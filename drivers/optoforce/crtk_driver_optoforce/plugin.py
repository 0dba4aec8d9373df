"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from crtk_driver_optoforce.config import OptoForceConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim
from crtk_drivers.samples import Wrench

_SIMULATED: Final = (0.0025, 0.0025, 0.0025, 0.0005, 0.0005, 0.0005)
"""N and N·m of one count of a simulated sensor."""


def _create(config: OptoForceConfig) -> Device:
    from crtk_driver_optoforce.device import OptoForceDevice

    return OptoForceDevice(config)


def _check_real(config: OptoForceConfig) -> None:
    for key, remedy in (
        ("port", "Give it (--port /dev/serial/by-id/usb-OptoForce...), or use --sim."),
        ("scale", "Give N (N·m) of one count on each axis, from the sensor's sensitivity report."),
    ):
        if not getattr(config, key):
            raise ConfigError(
                f"{key}: is required for a real sensor", where="optoforce", remedy=remedy
            )


def _at_sim(config: OptoForceConfig, sim: RunningSim) -> OptoForceConfig:
    scale = config.scale or _SIMULATED[: config.axes]
    return config.model_copy(update={"port": sim.ttys["serial"], "scale": scale})


def _sim_options(config: OptoForceConfig) -> Mapping[str, Any]:
    return {"sensor": config.sensor}


def _load(sim: RunningSim, wrench: Wrench) -> None:
    names = ("fx", "fy", "fz", "mx", "my", "mz")
    sim.control.inject("carry", **dict(zip(names, wrench.vector.tolist(), strict=True)))


def _link(config: OptoForceConfig, sim: RunningSim | None) -> DeviceLink | None:
    if "://" in config.port:
        return None
    return DeviceLink(serial={"serial": (config.port, config.baud)})


def _at_link(config: OptoForceConfig, link: DeviceLink) -> OptoForceConfig:
    return config.model_copy(update={"port": link.serial["serial"][0]})


PLUGIN = DevicePlugin(
    name="optoforce",
    summary="OptoForce force sensors at USB: 3 axes, 6 axes, four times 3 axes",
    config=OptoForceConfig,
    kind=DeviceKind.FORCE_SENSOR,
    create=_create,
    sim="optoforce",
    extra="optoforce",
    addresses=("port",),
    check_real=_check_real,
    sim_config=_at_sim,
    sim_options=_sim_options,
    sim_load=_load,
    link=LinkAccess(_link, _at_link),
)
