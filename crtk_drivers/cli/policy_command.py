"""``crtk-driver policy <device>``: who may command a device and who may listen, as a policy of SROS2."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import typer

from crtk_drivers import plugins
from crtk_drivers.cli.launch import described, launch_options
from crtk_drivers.cli.plugin_group import PluginGroup, Source
from crtk_drivers.cli.terminal import plain
from crtk_drivers.cli.typed_options import make_command, namespace_option
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros.names import checked_namespace
from crtk_drivers.ros.policy import policy


def build(plugin: DevicePlugin, panel: str) -> Any:
    """Return the command that prints the policy of a device."""

    def run(context: typer.Context, **given: Any) -> int:
        typer.echo(policy_of(plugin, given), nl=False)
        return 0

    help_text = (
        f"Print an SROS2 policy for {plain(plugin.name)}: who may command it, and who may listen. "
        "Connects to nothing. Give it the namespace and the configuration with which the driver will run: "
        "they decide which topics and services there are."
    )
    parameters = [namespace_option(plugin.name), *launch_options(plugin)]
    return make_command(plugin.name, run, parameters, help=help_text, panel=panel)


def policy_of(plugin: DevicePlugin, given: Mapping[str, Any]) -> str:
    """Return the policy of the device that the options describe.

    Where they say nothing at all, that of a typical one.

    Raises:
        ConfigError: the namespace or the configuration cannot be used.
    """
    namespace = checked_namespace(given["ns"])
    device, node = described(plugin, given)
    return policy(device, namespace, node)


class PolicyGroup(PluginGroup):
    """One command for each device."""

    source = Source(plugins.devices, build, plugins.device, "Devices")


app = typer.Typer()
policy_app = typer.Typer(cls=PolicyGroup, no_args_is_help=True, rich_markup_mode="rich")


@policy_app.callback()
def _policy() -> None:
    """Print who may command a device, and who may listen, as an SROS2 policy."""


app.add_typer(policy_app, name="policy")
