"""``crtk-driver``: the commands, and how errors become messages and exit codes.

Exit codes: 0 done, 1 a device or simulator is at fault, 2 it was not asked for in a usable way.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import typer

from crtk_drivers import plugins
from crtk_drivers.cli.bench_command import bench_app
from crtk_drivers.cli.check_command import CheckGroup
from crtk_drivers.cli.client_commands import PANEL
from crtk_drivers.cli.client_commands import add_to as add_client_commands
from crtk_drivers.cli.conform_command import add_to as add_conform
from crtk_drivers.cli.device_command import build as build_device
from crtk_drivers.cli.help_pages import HelpfulCommand, HelpfulGroup
from crtk_drivers.cli.list_command import list_plugins, list_simulators
from crtk_drivers.cli.new_command import Kind, write_plugin
from crtk_drivers.cli.plugin_group import PluginGroup, Source
from crtk_drivers.cli.policy_command import PolicyGroup
from crtk_drivers.cli.schema_command import print_schema
from crtk_drivers.cli.sim_command import SimGroup
from crtk_drivers.cli.terminal import print_error
from crtk_drivers.cli.up_command import (
    LabFile,
    SimOption,
    bring_up,
    check_lab,
    make_units,
    write_lab,
)
from crtk_drivers.errors import ConfigError, CrtkError, MissingExtra, PluginError

_USAGE_ERRORS = (ConfigError, PluginError, MissingExtra)
_TOOLS = "Tools"


class DeviceGroup(PluginGroup):
    """One command for each device, beside the tools."""

    source = Source(plugins.devices, build_device, plugins.device, "Devices")


@dataclass(frozen=True)
class Invocation:
    """What is taken out of the arguments before they are parsed."""

    arguments: list[str]
    ros_args: list[str]
    debug: bool


app = typer.Typer(
    name="crtk-driver",
    cls=DeviceGroup,
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)
sim_app = typer.Typer(cls=SimGroup, no_args_is_help=True, rich_markup_mode="rich")
policy_app = typer.Typer(cls=PolicyGroup, no_args_is_help=True, rich_markup_mode="rich")
check_app = typer.Typer(cls=CheckGroup, no_args_is_help=True, rich_markup_mode="rich")
lab_app = typer.Typer(cls=HelpfulGroup, no_args_is_help=True, rich_markup_mode="rich")


def _show_version(wanted: bool) -> None:
    if wanted:
        try:
            number = version("crtk-drivers")
        except PackageNotFoundError:
            number = "(not installed as a package)"
        typer.echo(f"crtk-drivers {number}")
        raise typer.Exit


def _allow_only(names: str | None) -> None:
    if names is not None:
        os.environ[plugins.ONLY] = names


def _tools() -> tuple[str, ...]:
    names = [command.name for command in app.registered_commands]
    names += [group.name for group in app.registered_groups]
    return tuple(name for name in names if name is not None)


@app.callback(
    epilog="[dim]First steps:[/dim]  crtk-driver list   ·   crtk-driver loopback --ns /demo   ·   "
    "crtk-driver ur --sim --ns /ur5"
)
def _root(
    context: typer.Context,
    show_version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
    only: Annotated[
        str | None,
        typer.Option(
            "--only",
            callback=_allow_only,
            is_eager=True,
            metavar="NAME,NAME",
            help=f"Load no other plugins. The variable {plugins.ONLY} does the same.",
        ),
    ] = None,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show tracebacks of errors. May stand anywhere.")
    ] = False,
) -> None:
    """Bring robots, servos, drives and sensors up as CRTK devices, on ROS 2, with or without hardware."""
    if context.obj.ros_args and context.invoked_subcommand in _tools():
        raise ConfigError(
            "is for running a device",
            where="--ros-args",
            remedy=f"Leave it out: `{context.invoked_subcommand}` starts no node.",
        )


@app.command("list", rich_help_panel=_TOOLS, cls=HelpfulCommand)
def _list(
    name: Annotated[str | None, typer.Argument(help="Show all that is known of one.")] = None,
) -> None:
    """List the devices and simulators, and whether they can be used."""
    raise typer.Exit(list_plugins(name))


@app.command("schema", rich_help_panel=_TOOLS, cls=HelpfulCommand)
def _schema(
    name: Annotated[str, typer.Argument(help="Of the device.")],
    markdown: Annotated[bool, typer.Option("--markdown", help="As tables for people.")] = False,
) -> None:
    """Print the JSON schema of a device's configuration."""
    print_schema(name, markdown)


@app.command("new", rich_help_panel=_TOOLS, cls=HelpfulCommand)
def _new(
    kind: Annotated[
        Kind, typer.Argument(help=f"What it is like: {', '.join(Kind)}.", show_default=False)
    ],
    name: Annotated[
        str,
        typer.Argument(
            help="Of the device: small letters, digits, underscores. `crtk-driver NAME` runs it.",
            show_default=False,
        ),
    ],
    directory: Annotated[
        Path,
        typer.Option(
            "--directory", "-C", exists=True, file_okay=False, help="Where its folder is made."
        ),
    ] = Path(),
) -> None:
    """Write a plugin for a device of your own: driver, simulator and tests to start from, which pass.

    A folder crtk-driver-NAME is made; nothing is overwritten. For example: crtk-driver new sensor my_scale
    """
    raise typer.Exit(write_plugin(kind, name, directory, _tools()))


@sim_app.callback()
def _sim() -> None:
    """Run a simulator alone, for any client."""


@sim_app.command("list", rich_help_panel=_TOOLS, cls=HelpfulCommand)
def _sim_list() -> None:
    """List the simulators."""
    list_simulators()


@policy_app.callback()
def _policy() -> None:
    """Print who may command a device, and who may listen, as an SROS2 policy."""


@check_app.callback()
def _check() -> None:
    """Check that a device, or its simulator, is ready to run."""


@app.command("up", rich_help_panel=_TOOLS, cls=HelpfulCommand)
def _up(
    lab: LabFile,
    devices: Annotated[
        list[str] | None,
        typer.Argument(metavar="[DEVICE]...", help="Only these, and no programs."),
    ] = None,
    sim: SimOption = False,
    logs: Annotated[
        Path | None,
        typer.Option(
            "--logs", metavar="DIR", help="For logs. [dim]\\[default: logs/NAME-TIME][/dim]"
        ),
    ] = None,
    log_level: Annotated[
        str, typer.Option("--log-level", help="Least severe records that are shown.")
    ] = "info",
    systemd: Annotated[
        str | None,
        typer.Option(
            "--systemd",
            metavar="DIR",
            help="Start nothing: write units of systemd into this folder; - prints them.",
        ),
    ] = None,
) -> None:
    """Bring up all devices of a lab, one process each, until Ctrl-C.

    They start in order, each once what carries it measures; one that ends is started again, DISABLED.
    Ctrl-C stops programs first, then the devices.
    """
    only = tuple(devices or ())
    if systemd is not None:
        raise typer.Exit(make_units(lab, only, sim, systemd))
    raise typer.Exit(bring_up(lab, only, sim, logs, log_level))


@lab_app.callback()
def _lab() -> None:
    """Write a lab file to start from, or check one."""


@lab_app.command("new", cls=HelpfulCommand)
def _lab_new(
    lab: Annotated[Path, typer.Argument(metavar="LAB", help="Where.")] = Path("lab.toml"),
    scan: Annotated[
        bool,
        typer.Option("--scan", help="Ask serial ports and CAN buses who is there; nothing moves."),
    ] = False,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at", metavar="PLACE", help="With --scan: look only here, as /dev/ttyUSB0 or can0."
        ),
    ] = None,
) -> None:
    """Write a lab file to start from. Nothing is overwritten."""
    if at and not scan:
        raise ConfigError("is where --scan looks", where="--at", remedy="Add --scan.")
    raise typer.Exit(write_lab(lab, tuple(at or ()) if scan else None))


@lab_app.command("check", cls=HelpfulCommand)
def _lab_check(lab: LabFile, sim: SimOption = False) -> None:
    """Check a lab file with the settings of all its devices, and show what would be started."""
    raise typer.Exit(check_lab(lab, sim))


add_client_commands(app)
app.add_typer(bench_app, name="bench", rich_help_panel=_TOOLS)
add_conform(app, PANEL)
app.add_typer(check_app, name="check", rich_help_panel=_TOOLS)
app.add_typer(lab_app, name="lab", rich_help_panel=_TOOLS)
app.add_typer(policy_app, name="policy", rich_help_panel=_TOOLS)
app.add_typer(sim_app, name="sim", rich_help_panel=_TOOLS)


def split_arguments(arguments: Sequence[str]) -> Invocation:
    """Take out ``--ros-args`` with all that follows it, and ``--debug``."""
    own = list(arguments)
    ros_args: list[str] = []
    if "--ros-args" in own:
        start = own.index("--ros-args")
        own, ros_args = own[:start], own[start:]
    return Invocation([each for each in own if each != "--debug"], ros_args, "--debug" in own)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    invocation = split_arguments(sys.argv[1:] if arguments is None else arguments)
    command: Any = typer.main.get_command(app)
    try:
        code = command.main(
            args=invocation.arguments,
            prog_name="crtk-driver",
            standalone_mode=True,
            obj=invocation,
        )
    except SystemExit as end:
        code = end.code
    except CrtkError as error:
        if invocation.debug:
            traceback.print_exception(error)
        print_error(error)
        code = 2 if isinstance(error, _USAGE_ERRORS) else 1
    return code if isinstance(code, int) else 0
