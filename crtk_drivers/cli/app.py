"""``crtk-driver``: the commands, and how errors become messages and exit codes.

Exit codes: 0 done, 1 a device or simulator is at fault, 2 it was not asked for in a usable way, 69 a library
that it needs is not installed.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any, Final

import typer
from rich.text import Text
from typing_extensions import override

from crtk_drivers import plugins
from crtk_drivers.cli.help_pages import Rows
from crtk_drivers.cli.own_commands import OWN_COMMANDS, OwnGroup
from crtk_drivers.cli.plugin_group import PluginGroup, Source
from crtk_drivers.cli.terminal import print_error
from crtk_drivers.errors import ConfigError, CrtkError, MissingExtra, PluginError
from crtk_drivers.errors.exit_codes import NOT_INSTALLED, USAGE_ERROR
from crtk_drivers.errors.wording import by_script, program

_NAME = "crtk-driver"
"""As the program is installed."""

_COMPLETE = "_CRTK_DRIVER_COMPLETE"
"""The variable in which a shell's completion asks for what may be typed next."""

_FOR_SHELLS = frozenset({"--install-completion", "--show-completion"})

_EXIT_CODES: Final = ((MissingExtra, NOT_INSTALLED), ((ConfigError, PluginError), USAGE_ERROR))
"""By the error that ends a command; 1 for any other."""


def _build(plugin: Any, panel: str) -> Any:
    from crtk_drivers.cli.device_command import build

    return build(plugin, panel)


class DeviceGroup(PluginGroup, OwnGroup):
    """One command for each device, beside our own."""

    source = Source(plugins.devices, _build, plugins.device, "Devices")

    @override
    def more_sections(self) -> Mapping[str, Rows]:
        """Return the options of the script of a clone, if that has started this."""
        if not by_script():
            return {}
        rows = [(Text(name, "cyan"), Text(told)) for name, told in SCRIPT_OPTIONS.items()]
        return {f"Options of {program()} itself, which stand first": rows}


SCRIPT_OPTIONS: Final = {
    "--extra NAME": "Bring the libraries of an extra, then go on. May be repeated.",
    "--run PROGRAM ...": "Run any program with the Python of the drivers.",
    "--test ...": "Run the tests; takes options of pytest.",
    "--pip ...": "pip, for the Python of the drivers: --pip install -e my_plugin",
}
"""What the script ``crtk-driver`` of a clone takes itself; this program never sees it."""


@dataclass(frozen=True)
class Invocation:
    """What is taken out of the arguments before they are parsed."""

    arguments: list[str]
    ros_args: list[str]
    debug: bool


app = typer.Typer(
    name=_NAME,
    cls=DeviceGroup,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)


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


@app.callback(
    epilog="[bold]First steps:[/bold]\n  crtk-driver list\n  crtk-driver loopback --ns /demo\n"
    "  crtk-driver ur --sim --ns /ur5"
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
    if context.obj.ros_args and context.invoked_subcommand in OWN_COMMANDS:
        raise ConfigError(
            "is for running a device",
            where="--ros-args",
            remedy=f"Leave it out: `{context.invoked_subcommand}` starts no node.",
        )


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
    is_completing = _COMPLETE in os.environ
    # A shell knows the program by its name, however this clone's script or `uv run` started it.
    is_for_shells = is_completing or bool(_FOR_SHELLS.intersection(invocation.arguments[:1]))
    try:
        code = command.main(
            args=invocation.arguments,
            prog_name=_NAME if is_for_shells else program(),
            complete_var=_COMPLETE,
            standalone_mode=True,
            obj=invocation,
        )
    except SystemExit as end:
        code = end.code
    except CrtkError as error:
        if is_completing:  # what is wrong is said when the command is run
            return 1
        if invocation.debug:
            traceback.print_exception(error)
        print_error(error)
        code = next((code for kinds, code in _EXIT_CODES if isinstance(error, kinds)), 1)
    return code if isinstance(code, int) else 0
