"""The entry point of the driver."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.dashboard import DASHBOARD_PORT
from crtk_driver_ur.device import UrDevice
from crtk_driver_ur.output_worker import SECONDARY_PORT
from crtk_driver_ur.primary import PORTS
from crtk_driver_ur.rtde.stream import RTDE_PORT
from crtk_driver_ur.tools import TOOLS
from crtk_drivers.device import DeviceKind
from crtk_drivers.errors import MissingExtra
from crtk_drivers.plugins import (
    DeviceLink,
    DevicePlugin,
    LinkAccess,
    RunningSim,
    SimFault,
    required,
)
from crtk_drivers.plugins.at_tool import attached

_FIRST_WITHOUT_WHEELS = (3, 13)
"""The Python for which ur-rtde 1.6 has no wheels any more; pyproject.toml leaves it out there as well."""


def _create(config: UrConfig) -> UrDevice:
    if config.control == "ur_rtde" and find_spec("rtde_control") is None:
        raise _no_library()
    if config.gripper is None:
        return UrDevice(config)
    plugin, its = attached(config.gripper, config.host)
    return UrDevice(config, plugin.make(its), plugin.tool_line)


def _no_library() -> MissingExtra:
    machine = platform.machine()
    if sys.version_info >= _FIRST_WITHOUT_WHEELS or machine != "x86_64":
        python = ".".join(map(str, sys.version_info[:2]))
        return MissingExtra(
            "ur-rtde",
            "ur",
            because=f"PyPI has no wheel of it for Python {python} on {machine}",
            remedy="Use control: native (the default), or Python 3.11 or 3.12 on x86_64, "
            "where pip install 'crtk-drivers[ur]' brings it.",
        )
    return MissingExtra("ur-rtde", "ur")


def _at_sim(config: UrConfig, sim: RunningSim) -> UrConfig:
    port = sim.ports.get("robot_api", config.robot_api_port)
    return config.model_copy(update={"host": sim.host, "robot_api_port": port})


def _sim_options(config: UrConfig) -> Mapping[str, Any]:
    cb3 = config.model in ("ur3", "ur5", "ur10")
    return {"model": config.model, "version": "3.15.8" if cb3 else "5.12.4"}


def _sim_tool(tool: RunningSim) -> Mapping[str, Any]:
    return {"tool_device": next(iter(tool.ttys.values()))}


def _link(config: UrConfig, sim: RunningSim | None) -> DeviceLink:
    ports = {str(port): port for port in (*PORTS, SECONDARY_PORT, RTDE_PORT, DASHBOARD_PORT)}
    if sim is not None and "robot_api" not in sim.ports:
        return DeviceLink(config.host, ports)
    return DeviceLink(config.host, {**ports, "robot_api": config.robot_api_port})


def _at_link(config: UrConfig, link: DeviceLink) -> UrConfig:
    port = link.tcp.get("robot_api", config.robot_api_port)
    return config.model_copy(update={"host": link.host, "robot_api_port": port})


PLUGIN = DevicePlugin(
    name="ur",
    summary="Universal Robots arms: UR3/5/10 (CB3), UR3e/5e/10e/16e, UR20, UR30",
    config=UrConfig,
    kind=DeviceKind.ARM,
    create=_create,
    sim="ur",
    addresses=("host",),
    check_real=required("host", "192.168.1.10"),
    sim_config=_at_sim,
    sim_options=_sim_options,
    sim_faults={SimFault.EMERGENCY_STOP: "emergency_stop"},
    tool=lambda config: config.gripper,
    sim_tool=_sim_tool,
    tools=TOOLS,
    link=LinkAccess(_link, _at_link),
)
