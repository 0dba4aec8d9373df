"""``crtk-driver sim <name>``: run a simulator alone, for any client."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import typer
from rich.table import Table
from rich.text import Text

from crtk_drivers import plugins
from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.list_command import list_simulators
from crtk_drivers.cli.log_setup import LogFormat, set_up_logging
from crtk_drivers.cli.plugin_group import PluginGroup, Source
from crtk_drivers.cli.terminal import ERR, plain, sentence
from crtk_drivers.cli.typed_options import given_settings, make_command, setting_options
from crtk_drivers.config.keys import heading_of
from crtk_drivers.errors import ConnectionLost
from crtk_drivers.plugins import RunningSim, SimPlugin
from crtk_drivers.plugins.sim_plugin import start_sim
from crtk_drivers.status.stop_request import stop_signals

_POLL = 0.2


def build(plugin: SimPlugin, panel: str) -> Any:
    """Return the command of a simulator."""
    parameters = setting_options(
        plugin.Config,
        lambda name: heading_of(plugin.Config, name) or f"Options of the {plugin.name} simulator",
    )

    def run(context: typer.Context, **given: Any) -> int:
        return run_simulator(plugin, given)

    help_text = f"{sentence(plugin.summary)}\n\nRuns until Ctrl-C, for any client of the device."
    return make_command(plugin.name, run, parameters, help=help_text, panel=panel)


def run_simulator(plugin: SimPlugin, given: Mapping[str, Any]) -> int:
    """Start the simulator, tell where it is, and wait for a signal.

    Raises:
        ConfigError: an option has an impossible value.
        ConnectionFailed: it did not start.
        ConnectionLost: it ended by itself.
    """
    set_up_logging(ERR, "info", LogFormat.TEXT)
    with stop_signals() as stopped:
        running = start_sim(plugin, given_settings(plugin.Config, given))
        try:
            _tell_ports(plugin, running)
            while not stopped.is_set():
                time.sleep(_POLL)
                if not running.running:
                    raise ConnectionLost(
                        "the simulator has ended by itself", where=f"{plugin.name} {running.host}"
                    )
        finally:
            running.stop()
    return 0


def _tell_ports(plugin: SimPlugin, running: RunningSim) -> None:
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 3, 0, 2))
    for name, port in running.ports.items():
        table.add_row(Text(name.replace("_", " ")), Text(f"{running.host}:{port}"))
    # A simulator of somebody else may have none of these.
    for kind in ("ttys", "paths"):
        for name, path in getattr(running, kind, {}).items():
            table.add_row(Text(name.replace("_", " ")), Text(path))
    ERR.print(f"[bold cyan]{plain(plugin.name)}[/] simulator running, process {running.pid}")
    ERR.print(table)
    for hint in getattr(running, "hints", ()):
        ERR.print(f"  {plain(hint)}", soft_wrap=True)
    ERR.print("[dim]Ctrl-C ends it.[/dim]")


class SimGroup(PluginGroup):
    """One command for each simulator."""

    source = Source(plugins.sims, build, plugins.simulator, "Simulators", plugins.FORMER)


app = typer.Typer()
sim_app = typer.Typer(cls=SimGroup, no_args_is_help=True, rich_markup_mode="rich")


@sim_app.callback()
def _sim() -> None:
    """Run a simulator alone, for any client."""


@sim_app.command("list", rich_help_panel="Tools", cls=HelpfulCommand)
def _sim_list() -> None:
    """List the simulators."""
    list_simulators()


app.add_typer(sim_app, name="sim")
