"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from crtk_driver_ndi.config import NdiConfig, ToolConfig
from crtk_driver_ndi.rom import read_rom
from crtk_driver_ndi.tools import TOOLS
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim, SimFault
from crtk_drivers.samples import Pose

_SIMULATED: Final = (
    {"name": "pointer", "part_number": "SIM-POINTER"},
    {"name": "reference", "part_number": "SIM-REFERENCE"},
)
"""Tools at a simulator, for who names none."""


def _create(config: NdiConfig) -> Device:
    from crtk_driver_ndi.device import NdiDevice

    return NdiDevice(config)


def _check_real(config: NdiConfig) -> None:
    key, example = (
        ("host", "192.168.1.30") if config.transport == "tcp" else ("port", "/dev/ttyUSB0")
    )
    if not getattr(config, key):
        raise ConfigError(
            f"{key}: is required for a real tracker over {config.transport}",
            where="ndi",
            remedy=f"Give it (--{key} {example}), or use --sim.",
        )


def _with_tools(config: NdiConfig) -> NdiConfig:
    if config.tools:
        return config
    return NdiConfig(**{**config.model_dump(exclude_unset=True), "tools": _SIMULATED})


def _at_sim(config: NdiConfig, sim: RunningSim) -> NdiConfig:
    config = _with_tools(config)
    where = {"host": sim.host, "tcp_port": sim.ports["tcp"], "port": sim.ttys["serial"]}
    return config.model_copy(update=where)


def _sim_options(config: NdiConfig) -> Mapping[str, Any]:
    family = {} if config.family == "auto" else {"family": config.family}
    return {"wired": _plugged(_with_tools(config).tools), **family}


def _plugged(tools: Sequence[ToolConfig]) -> str:
    """Return what hangs at a simulated tracker: at the ports that are named, else at the first free one."""
    plugs: dict[int, str] = {}
    for tool in sorted(tools, key=lambda tool: (tool.port or 100, tool.channel or 0)):
        part = "?" if tool.rom else tool.part_number
        if tool.is_wireless or not part:
            continue
        same = [port for port, text in plugs.items() if text == part] if tool.channel else []
        port = tool.port or next(iter(same), max(plugs, default=0) + 1)
        plugs[port] = part + "*2" * bool(tool.channel)
    return ",".join(plugs.get(port, "") for port in range(1, max(plugs, default=0) + 1))


def _markers(config: NdiConfig) -> Mapping[str, str]:
    return {
        tool.namespace: read_rom(tool.rom).part_number if tool.rom else tool.part_number
        for tool in _with_tools(config).tools
    }


def _put(sim: RunningSim, marker: str, pose: Pose, wall_ns: int) -> None:
    position, orientation = pose.position.tolist(), pose.orientation.tolist()
    sim.control.call(
        "put", part_number=marker, ns=wall_ns, position=position, orientation=orientation
    )


def _link(config: NdiConfig, sim: RunningSim | None) -> DeviceLink | None:
    if config.transport == "tcp":
        return DeviceLink(config.host, {"tcp": config.tcp_port})
    if "://" in config.port:
        return None
    return DeviceLink(serial={"serial": (config.port, config.baud)})


def _at_link(config: NdiConfig, link: DeviceLink) -> NdiConfig:
    if link.serial:
        port, _ = link.serial["serial"]
        return config.model_copy(update={"port": port})
    return config.model_copy(update={"host": link.host, "tcp_port": link.tcp["tcp"]})


PLUGIN = DevicePlugin(
    name="ndi",
    summary="NDI trackers: Polaris Vicra, Spectra, Vega, Lyra, and Aurora, over serial or TCP",
    config=NdiConfig,
    kind=DeviceKind.TRACKER,
    create=_create,
    sim="ndi",
    extra="ndi",
    addresses=("host", "port"),
    check_real=_check_real,
    sim_config=_at_sim,
    sim_options=_sim_options,
    markers=_markers,
    sim_put=_put,
    sim_faults={SimFault.COVER: "hide"},
    tools=TOOLS,
    link=LinkAccess(_link, _at_link),
)
