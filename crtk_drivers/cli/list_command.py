"""``crtk-driver list``: which devices, simulators and pages there are, and whether they can be used."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated

import typer
from rich.text import Text

from crtk_drivers import plugins
from crtk_drivers.cli.help_pages import HelpfulCommand, completed_from
from crtk_drivers.cli.terminal import OUT, plain, sentence
from crtk_drivers.errors import MissingExtra
from crtk_drivers.errors.wording import worded
from crtk_drivers.plugins import PluginEntry

app = typer.Typer()

_KINDS = {plugins.DEVICES: "device", plugins.SIMS: "simulator", plugins.PAGES: "page"}


@app.command("list", cls=HelpfulCommand)
def _list(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Show all that is known of one.",
            autocompletion=completed_from(lambda: {**plugins.devices(), **plugins.sims()}),
        ),
    ] = None,
) -> None:
    """List the devices and simulators, and whether they can be used."""
    raise typer.Exit(list_plugins(name))


def list_plugins(name: str | None) -> int:
    """Print all plugins, a line each, or all that is known of those of one name.

    Simulators that belong to a device have no line of their own, unless they cannot be used.

    Returns:
        1 if the plugin asked for cannot be used, otherwise 0.

    Raises:
        PluginError: there is no plugin `name`.
    """
    groups = (plugins.devices(), plugins.sims(), plugins.pages())
    if name is None:
        devices, simulators, pages = groups
        _print_group("Devices", devices)
        own = {entry.description.sim for entry in devices.values() if entry.description}
        others = {
            name: entry
            for name, entry in simulators.items()
            if name not in own or _state(entry) in _TROUBLE
        }
        _print_group("Simulators of no device", others)
        _print_group("Pages for the browser", pages)
        OUT.print("All that is known of one, and all simulators:")
        for command in ("list NAME", "sim list"):
            OUT.print(Text(worded(f"  crtk-driver {command}")), soft_wrap=True)
        return 0
    entries = [group[name] for group in groups if name in group]
    if not entries:
        everything = {each: entry for group in groups for each, entry in group.items()}
        plugins.find_entry(everything, name, "device, simulator or page")
    are_shown = [_describe(entry) for entry in entries]
    return 0 if all(are_shown) else 1


def list_simulators() -> None:
    """Print the simulators."""
    _print_group("Simulators", plugins.sims())


class State(StrEnum):
    """Whether a plugin can be used, as far as that is known without importing it."""

    OK = "ok"
    """It was imported."""
    INSTALLED = "installed"
    NEEDS_EXTRA = "needs extra"
    BROKEN = "broken"


_STYLES = {
    State.OK: "green",
    State.INSTALLED: "green",
    State.NEEDS_EXTRA: "yellow",
    State.BROKEN: "bold red",
}
_TROUBLE = (State.NEEDS_EXTRA, State.BROKEN)


def _print_group(title: str, entries: Mapping[str, PluginEntry]) -> None:
    OUT.print(Text(title, "bold"))
    states = {name: _state_text(entry) for name, entry in entries.items()}
    columns = [max(map(len, words), default=0) + 2 for words in (states, states.values())]
    for name, state in states.items():
        line = Text.assemble("  ", (name.ljust(columns[0]), "bold cyan"), state)
        line.append(" " * (columns[1] - len(state))).append_text(_summary(entries[name]))
        if OUT.is_terminal and _state(entries[name]) not in _TROUBLE:
            OUT.print(line, overflow="ellipsis", no_wrap=True)
        else:
            OUT.print(line, soft_wrap=True)
    if not entries:
        OUT.print(Text("  none installed", "dim"))
    OUT.print()


def _state(entry: PluginEntry) -> State:
    """Return what is known of it: that one is ok only where it was imported."""
    if entry.missing:
        return State.NEEDS_EXTRA
    if entry.is_described and not entry.is_loaded:
        return State.INSTALLED
    return State.BROKEN if entry.error else State.OK


def _state_text(entry: PluginEntry) -> Text:
    state = _state(entry)
    extra = f" {entry.missing.extra}" if entry.missing else ""
    return Text(f"{state}{extra}", _STYLES[state])


def _summary(entry: PluginEntry) -> Text:
    """Return what it is, or why it cannot be loaded; and the package that brings it, if it is not ours."""
    told = entry.description
    if told is not None:
        text = Text.from_markup(sentence(told.summary))
    else:
        text = Text(f"{type(entry.error).__name__}: {entry.error}", "red")
    if entry.distribution != plugins.OWN_DISTRIBUTION:
        text.append(f"  ({_package(entry)})", "dim")
    return text


def _is_device(entry: PluginEntry) -> bool:
    return entry.entry_point.group == plugins.DEVICES


def _package(entry: PluginEntry) -> str:
    return f"{entry.distribution} {entry.version}".strip() or "unknown package"


def _describe(entry: PluginEntry) -> bool:
    """Print all that is known of one, and return whether it can be used."""
    kind = _KINDS[entry.entry_point.group]
    error = entry.error  # which imports it
    heading = Text.assemble((entry.name, "bold cyan"), f"  {kind}  ", _state_text(entry))
    OUT.print(heading.append(f"  {_package(entry)}  {entry.entry_point.value}", "dim"))
    if isinstance(error, MissingExtra):
        OUT.print(Text(f"\n{worded(str(error))}", "yellow"), soft_wrap=True)
        return False
    if error:
        OUT.print(Text(f"\n{entry.traceback}"), soft_wrap=True)
        return False
    OUT.print(sentence(entry.plugin.summary))
    if entry.missing:
        OUT.print(Text(worded(str(entry.missing)), "yellow"), soft_wrap=True)
    if _is_device(entry):
        sim = entry.plugin.sim
        OUT.print(f"Simulator: {plain(sim)}, by --sim.\n" if sim else "It has no simulator.\n")
        if not _print_offered(entry):
            return False
    OUT.print()
    return True


def _print_offered(entry: PluginEntry) -> bool:
    """Print what a device offers, or that its plugin fails at that, and return whether it does not."""
    from crtk_drivers.cli.offered_view import print_offered  # numpy is not needed otherwise

    try:
        print_offered(entry.plugin)
    except Exception as error:  # a stranger's device may raise anything
        why = " ".join(f"{type(error).__name__}: {error}".split())
        told = f"{entry.name}: what it offers cannot be shown: {why}"
        OUT.print(Text(told, "red"), soft_wrap=True)
        return False
    return True
