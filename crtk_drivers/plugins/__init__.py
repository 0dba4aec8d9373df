"""Devices, simulators and pages of any package: what it says of them, and where they are found."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from crtk_drivers.plugins.description import Description
from crtk_drivers.plugins.entries import (
    DEVICES,
    FORMER,
    ONLY,
    OWN_DISTRIBUTION,
    PAGES,
    SIMS,
    PluginEntry,
    commands_of,
    described,
    device,
    devices,
    find_entry,
    page,
    pages,
    sims,
    simulator,
    typical_device,
)

if TYPE_CHECKING:
    from crtk_drivers.plugins.declared import (
        DeviceLink,
        DevicePlugin,
        LinkAccess,
        SimFault,
        Tool,
        required,
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
    "Description",
    "DeviceLink",
    "DevicePlugin",
    "Finder",
    "FoundDevice",
    "LinkAccess",
    "PluginEntry",
    "RunningSim",
    "SimControl",
    "SimFault",
    "SimPlugin",
    "Tool",
    "commands_of",
    "described",
    "device",
    "devices",
    "find_entry",
    "page",
    "pages",
    "required",
    "sims",
    "simulator",
    "typical_device",
]

# Imported when first used: to list plugins needs none of it.
_MODULES = {
    "DevicePlugin": "declared",
    "Finder": "finder",
    "FoundDevice": "finder",
    "LinkAccess": "declared",
    "DeviceLink": "declared",
    "SimFault": "declared",
    "RunningSim": "sim_plugin",
    "SimControl": "sim_plugin",
    "SimPlugin": "sim_plugin",
    "Tool": "declared",
    "required": "declared",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
