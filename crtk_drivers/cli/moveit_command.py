"""``crtk-driver moveit <device>``: the file that tells MoveIt of a device's actions."""

from __future__ import annotations

from typing import Any

import typer

from crtk_drivers import plugins
from crtk_drivers.cli.launch import described, launch_options
from crtk_drivers.cli.plugin_group import PluginGroup, Source
from crtk_drivers.cli.terminal import plain
from crtk_drivers.cli.typed_options import make_command, namespace_option
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros.moveit_file import controllers_file
from crtk_drivers.ros.names import checked_namespace


def build(plugin: DevicePlugin, panel: str) -> Any:
    """Return the command that prints the file of a device."""

    def run(context: typer.Context, **given: Any) -> int:
        namespace = checked_namespace(given["ns"])
        device, node = described(plugin, given)
        typer.echo(controllers_file(device, namespace, node), nl=False)
        return 0

    help_text = (
        f"Print MoveIt's file of controllers for {plain(plugin.name)}, for "
        "moveit_simple_controller_manager. Connects to nothing. Give it the namespace and the configuration "
        "with which the driver will run, which is started with --set node.moveit=true."
    )
    parameters = [namespace_option(plugin.name), *launch_options(plugin)]
    return make_command(plugin.name, run, parameters, help=help_text, panel=panel)


class MoveItGroup(PluginGroup):
    """One command for each device."""

    source = Source(plugins.devices, build, plugins.device, "Devices")


app = typer.Typer()
moveit_app = typer.Typer(cls=MoveItGroup, no_args_is_help=True, rich_markup_mode="rich")


@moveit_app.callback()
def _moveit() -> None:
    """Print the file that tells MoveIt of a device's actions: of moveit_simple_controller_manager."""


app.add_typer(moveit_app, name="moveit")
