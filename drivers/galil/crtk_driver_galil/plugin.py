"""The entry point of the driver."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from crtk_driver_galil.config import GalilConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim, axes_ways

SIMULATED_AXES = "ABC"
"""Axes of the arm that ``--sim`` shows when no joints are configured."""


def _simulated_joint(letter: str) -> dict[str, Any]:
    return {
        "axis": letter,
        "scale": 2.0 * math.pi / 100_000,
        "lower": -3.0,
        "upper": 3.0,
        "velocity": 2.0,
        "acceleration": 10.0,
    }


TYPICAL: Mapping[str, Any] = {
    "joints": {f"joint_{letter.lower()}": _simulated_joint(letter) for letter in SIMULATED_AXES}
}
"""The arm that ``--sim`` shows when no joints are configured: 100 000 counts a turn."""


def _create(config: GalilConfig) -> Device:
    from crtk_driver_galil.controller import create

    return create(config)


def _at_sim(config: GalilConfig, sim: RunningSim) -> GalilConfig:
    place = {"host": sim.host, "tcp_port": sim.ports["command"], "udp_port": sim.ports["records"]}
    return axes_ways.with_joints(config, TYPICAL).model_copy(update=place)


def _link(config: GalilConfig, sim: RunningSim | None) -> DeviceLink | None:
    return DeviceLink(config.host, {"command": config.tcp_port}, {"records": config.udp_port})


def _at_link(config: GalilConfig, link: DeviceLink) -> GalilConfig:
    place = {
        "host": link.host,
        "tcp_port": link.tcp["command"],
        "udp_port": link.udp["records"],
    }
    return config.model_copy(update=place)


PLUGIN = DevicePlugin(
    name="galil",
    summary="Galil DMC motion controllers (40x0, 41x3, 52xx0, 30000, ...): their axes as one arm",
    config=GalilConfig,
    kind=DeviceKind.ARM,
    create=_create,
    sim="galil",
    addresses=("host", "tcp_port", "udp_port"),
    check_real=axes_ways.check_real(
        "galil", {"host": "--host 192.168.1.20", "joints": "--config arm.yaml"}
    ),
    sim_config=_at_sim,
    typical=TYPICAL,
    link=LinkAccess(_link, _at_link),
)
