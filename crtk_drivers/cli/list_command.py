"""``crtk-driver list``: which devices, simulators and pages there are, and whether they can be used."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import groupby
from typing import Annotated

import typer
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from crtk_drivers import plugins
from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.terminal import OUT, sentence
from crtk_drivers.commands import Command, Level, find, is_name
from crtk_drivers.errors.wording import worded
from crtk_drivers.plugins import PluginEntry

app = typer.Typer()

_KINDS = {plugins.DEVICES: "device", plugins.SIMS: "simulator", plugins.PAGES: "page"}


@app.command("list", cls=HelpfulCommand)
def _list(
    name: Annotated[str | None, typer.Argument(help="Show all that is known of one.")] = None,
) -> None:
    """List the devices and simulators, and whether they can be used."""
    raise typer.Exit(list_plugins(name))


def list_plugins(name: str | None) -> int:
    """Print all plugins, or all that is known of those of one name.

    Returns:
        1 if the plugin asked for cannot be used, otherwise 0.

    Raises:
        PluginError: there is no plugin `name`.
    """
    if name is None:
        _print_group("Devices", plugins.devices())
        _print_group("Simulators", plugins.sims())
        _print_group("Pages for the browser", plugins.pages())
        return 0
    groups = (plugins.devices(), plugins.sims(), plugins.pages())
    entries = [group[name] for group in groups if name in group]
    if not entries:
        plugins.device(name)
    for entry in entries:
        _describe(entry)
    return 1 if any(entry.error for entry in entries) else 0


def list_simulators() -> None:
    """Print the simulators."""
    _print_group("Simulators", plugins.sims())


def _print_group(title: str, entries: Mapping[str, PluginEntry]) -> None:
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 1, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    for name, entry in entries.items():
        table.add_row(Text(name, "bold cyan"), _summary(entry))
    OUT.print(Text(f"{title}\n", "bold"))
    OUT.print(table if entries else Text("  none installed", "dim"))
    OUT.print()


def _summary(entry: PluginEntry) -> RenderableType:
    lines = Text.assemble(_status(entry), (f"  {_package(entry)}", "dim"))
    told = entry.description
    if told is None:
        return lines.append_text(_trouble(entry))
    if _is_device(entry):
        lines.append(f"  simulator: {told.sim}" if told.sim else "  no simulator", "dim")
    lines.append(f"\n{sentence(told.summary)}")
    if entry.missing:
        lines.append(f"\n{entry.missing}", "yellow")
    commands = {name: find(name) for name in told.commands.split() if is_name(name)}
    return lines.append(f"\n{short_names(commands)}", "dim") if commands else lines


def _trouble(entry: PluginEntry) -> Text:
    if entry.missing:
        return Text(f"\n{entry.missing}", "yellow")
    text = Text(f"\n{type(entry.error).__name__}: {entry.error}", "red")
    return text.append(worded(f"\nTraceback: crtk-driver list {entry.name}"), "dim")


def _is_device(entry: PluginEntry) -> bool:
    return entry.entry_point.group == plugins.DEVICES


def _package(entry: PluginEntry) -> str:
    return f"{entry.distribution} {entry.version}".strip() or "unknown package"


def _status(entry: PluginEntry) -> Text:
    """Say what is known of it: that one is ok only where it was imported."""
    if entry.missing:
        return Text("needs extra", "yellow")
    if entry.is_described and not entry.is_loaded:
        return Text("installed", "green")
    return Text("broken", "bold red") if entry.error else Text("ok", "green")


def short_names(commands: Mapping[str, Command]) -> str:
    """Return the names in one line: ``measured_js/cp  servo_jp/jr  hold  body/: servo_cv/cf``."""
    own = {name: command for name, command in commands.items() if "/" not in name}
    parts = _short(own)
    spaces = dict.fromkeys(name.rpartition("/")[0] for name in commands if "/" in name)
    for space in spaces:
        inside = {
            name.removeprefix(f"{space}/"): command
            for name, command in commands.items()
            if name.startswith(f"{space}/")
        }
        parts.append(f"{space}/: {' '.join(_short(inside))}")
    return "  ".join(parts)


def _short(commands: Mapping[str, Command]) -> list[str]:
    """Return names, those of a level joined."""
    parts: list[str] = []
    for level, rows in groupby(commands.items(), key=lambda row: row[1].level):
        names = [name for name, _ in rows]
        plain = level in (Level.STATE, Level.QUERY, Level.SETTING)
        parts += names if plain else [_joined(level, names)]
    return parts


def _joined(level: Level, names: Iterable[str]) -> str:
    return f"{level}_{'/'.join(name.removeprefix(f'{level}_') for name in names)}"


def _describe(entry: PluginEntry) -> None:
    kind = _KINDS[entry.entry_point.group]
    error = entry.error  # which imports it
    heading = Text.assemble((entry.name, "bold cyan"), f"  {kind}  ", _status(entry))
    OUT.print(heading.append(f"  {_package(entry)}  {entry.entry_point.value}", "dim"))
    if error:
        OUT.print(Text(f"\n{entry.traceback}"), soft_wrap=True)
        return
    OUT.print(f"{sentence(entry.plugin.summary)}\n")
    if _is_device(entry):
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
        for column in ("command", "units", "what it is"):
            table.add_column(column)
        for name, command in plugins.commands_of(entry.name).items():
            table.add_row(Text(name, "cyan"), command.units, command.summary)
        OUT.print(table)
        OUT.print()
