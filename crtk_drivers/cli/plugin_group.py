"""A group of commands with one for each plugin, made when it is asked for.

``crtk-driver ur`` imports the plugin ``ur`` and no other; only a list of commands imports them all. A
plugin that cannot be loaded is still there, says so in the list, and raises its error when it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import typer
from typing_extensions import override

from crtk_drivers.cli.help_pages import HelpfulGroup
from crtk_drivers.cli.terminal import plain
from crtk_drivers.cli.typed_options import make_command
from crtk_drivers.plugins import PluginEntry


@dataclass(frozen=True)
class Source:
    """Where the plugins of a group come from, and what is made of them.

    Attributes:
        find: returns the plugins.
        build: returns the command of a plugin, to be listed in a panel.
        refuse: raises the error for a name that is neither a plugin nor a command.
        panel: of the plugins' commands in the help.
        former: names that plugins had before, and have now.
    """

    find: Callable[[], Mapping[str, PluginEntry]]
    build: Callable[[Any, str], Any]
    refuse: Callable[[str], Any]
    panel: str
    former: Mapping[str, str] = field(default_factory=dict)


class PluginGroup(HelpfulGroup):
    """Subclass it with the source of its plugins."""

    source: ClassVar[Source]

    @cached_property
    def _plugins(self) -> Mapping[str, PluginEntry]:
        return self.source.find()

    @override
    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        """Return the plugins, then the other commands."""
        own = super().list_commands(ctx)
        plugins = [name for name in self._plugins if "@" not in name and name not in own]
        return [*plugins, *own]

    @override
    def get_command(self, ctx: typer.Context, cmd_name: str) -> Any:  # type: ignore[override]
        """Return the command, made of the plugin of that name if it is not one of the others."""
        own = super().get_command(ctx, cmd_name)
        if own is not None:
            return own
        entry = self._plugins.get(self.source.former.get(cmd_name, cmd_name))
        if entry is None:
            return None
        if entry.error is not None:
            return self._placeholder(entry)
        return self.source.build(entry.plugin, self.source.panel)

    @override
    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]
        """Refuse an unknown name in our own words."""
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            self.source.refuse(name)
        return super().resolve_command(ctx, args)

    def _placeholder(self, entry: PluginEntry) -> Any:
        def run(**_: Any) -> int:
            assert entry.plugin is None  # raises
            return 1

        text = "broken, see [bold]crtk-driver list[/bold]"
        if entry.missing:
            text = f"needs an extra: {plain(str(entry.missing))}"
        return make_command(
            entry.name,
            run,
            [],
            help=f"[red]{text}[/red]",
            panel=self.source.panel,
        )
