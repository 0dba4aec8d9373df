"""The plugin and the configuration of a device that hangs at the tool of an arm."""

from __future__ import annotations

from crtk_drivers.config import AttachedConfig, DeviceConfig, from_values, load
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import entries
from crtk_drivers.plugins.declared import DevicePlugin

__all__ = ["attached"]


def attached(given: AttachedConfig, host: str) -> tuple[DevicePlugin, DeviceConfig]:
    """Return the plugin of an attached device, and its configuration at the tool of an arm.

    Args:
        given: what the configuration of the arm says of it.
        host: address of the arm.

    Raises:
        PluginError, MissingExtra: there is no such device, or a library of it is missing.
        ConfigError: a setting is wrong, or it cannot hang at a tool.
    """
    plugin = entries.device(given.plugin)
    if plugin.at_tool is None:
        raise ConfigError(
            f"{given.plugin} cannot hang at the tool of an arm",
            where="gripper",
            remedy="Run it beside the arm: crtk-driver up with both in a lab file.",
        )
    config = load(plugin.config, from_values(given.settings, "gripper.settings"))
    return plugin, plugin.at_tool(config, host)
