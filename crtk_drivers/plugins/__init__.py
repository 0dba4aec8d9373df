"""Devices, simulators and pages of any package: what it says of them, and where they are found."""

from crtk_drivers.plugins.declared import DevicePlugin, LinkAccess, NetworkLink, Tool, required
from crtk_drivers.plugins.entries import (
    DEVICES,
    FORMER,
    ONLY,
    OWN_DISTRIBUTION,
    PAGES,
    SIMS,
    PluginEntry,
    commands_of,
    device,
    devices,
    page,
    pages,
    sims,
    simulator,
)
from crtk_drivers.plugins.finder import Finder, FoundDevice
from crtk_drivers.plugins.sim_plugin import RunningSim, SimControl, SimPlugin

__all__ = [
    "DEVICES",
    "FORMER",
    "ONLY",
    "OWN_DISTRIBUTION",
    "PAGES",
    "SIMS",
    "DevicePlugin",
    "Finder",
    "FoundDevice",
    "LinkAccess",
    "NetworkLink",
    "PluginEntry",
    "RunningSim",
    "SimControl",
    "SimPlugin",
    "Tool",
    "commands_of",
    "device",
    "devices",
    "page",
    "pages",
    "required",
    "sims",
    "simulator",
]
