"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

from crtk_driver_canopen.config import BusConfig, CanopenConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.errors import ConfigError, MissingExtra
from crtk_drivers.plugins import (
    DeviceLink,
    DevicePlugin,
    Finder,
    LinkAccess,
    RunningSim,
    Tool,
    axes_ways,
)

SIMULATED_JOINTS = 6
"""Joints of the arm that ``--sim`` shows when none are configured."""


LIBRARIES = {"can": "python-can", "canopen": "canopen"}
"""What the extra brings, by the name it is imported by; the plugin itself loads without."""


def _tools() -> tuple[Tool, ...]:
    """Return the commands for people; none where the libraries are missing."""
    if not all(map(find_spec, LIBRARIES)):
        return ()
    from crtk_driver_canopen.tools import TOOLS

    return TOOLS


def _finder() -> Finder | None:
    if not all(map(find_spec, LIBRARIES)):
        return None
    from crtk_driver_canopen.finding import FINDER

    return FINDER


def _create(config: CanopenConfig) -> Device:
    for module, name in LIBRARIES.items():
        if find_spec(module) is None:
            raise MissingExtra(name, "canopen")
    from crtk_driver_canopen.device import CanopenDevice

    return CanopenDevice(config)


def _require_joints(config: CanopenConfig) -> None:
    if not config.joints:
        raise ConfigError(
            "no joints are configured",
            where="canopen",
            remedy="Give a file (--config joints.yaml): see docs/canopen.md; 'crtk-driver canopen scan' "
            "lists the nodes on a bus.",
        )


def _simulated_joint(node: int) -> dict[str, Any]:
    """Return the joint of a simulated drive: it moves freely, and does not care how far."""
    return {
        "node": node,
        "gear": 100.0,
        "lower": -3.0,
        "upper": 3.0,
        "velocity": 2.0,
        "acceleration": 10.0,
        "effort": 20.0,
        "modes": ("csp", "csv", "cst"),
        "homing": {"method": 37},
    }


TYPICAL: Mapping[str, Any] = {
    "period": 0.008,
    "joints": {f"joint_{node}": _simulated_joint(node) for node in range(1, SIMULATED_JOINTS + 1)},
}
"""The arm that ``--sim`` shows when no joints are configured."""


def _at_sim(config: CanopenConfig, sim: RunningSim) -> CanopenConfig:
    config = axes_ways.with_joints(config, TYPICAL)
    bus = BusConfig(
        interface="crtk",
        channel=sim.paths["crtk"],
        bitrate=config.bus.bitrate,
        load_limit=config.bus.load_limit,
    )
    return config.model_copy(update={"bus": bus})


def _sim_options(config: CanopenConfig) -> Mapping[str, Any]:
    config = axes_ways.with_joints(config, TYPICAL)
    nodes = config.nodes
    axes = 1 + max(joint.axis for joint in config.joints.values())
    return {
        "first_node": min(nodes),
        "nodes": max(nodes) - min(nodes) + 1,
        "axes": axes,
        "bitrate": config.bus.bitrate,
        "realtime": True,
    }


def _link(config: CanopenConfig, sim: RunningSim | None) -> DeviceLink:
    """Return the link to a gateway of socketcand, or the adapter, which the bus of a simulator is as well."""
    bus = config.bus if sim is None else _at_sim(config, sim).bus
    port = bus.options.get("port")
    if bus.interface == "socketcand" and isinstance(port, int):
        return DeviceLink(str(bus.options.get("host")), {"socketcand": port})
    own = {"interface": bus.interface, "channel": bus.channel, "bitrate": bus.bitrate}
    return DeviceLink(can={"socketcand": {**own, **bus.options}})


def _at_link(config: CanopenConfig, link: DeviceLink) -> CanopenConfig:
    own = config.bus.options if config.bus.interface == "socketcand" else {}
    options = {**own, "host": link.host, "port": link.tcp["socketcand"]}
    bus = config.bus.model_copy(update={"interface": "socketcand", "options": options})
    return config.model_copy(update={"bus": bus})


PLUGIN = DevicePlugin(
    name="canopen",
    summary="CANopen servo drives (CiA 402) on a CAN bus as one arm",
    config=CanopenConfig,
    kind=DeviceKind.ARM,
    create=_create,
    sim="canopen",
    extra="canopen",
    addresses=("bus.interface", "bus.channel"),
    check_real=_require_joints,
    sim_config=_at_sim,
    sim_options=_sim_options,
    finder=_finder(),
    tools=_tools(),
    typical=TYPICAL,
    link=LinkAccess(_link, _at_link),
)
