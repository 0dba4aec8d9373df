"""A group of commands with one for each plugin, made when it is asked for.

``crtk-driver ur`` imports the plugin ``ur`` and no other; a list of commands imports those that are not
described beside their entry points. A plugin that cannot be loaded is still there, says so in the list, and
raises its error when it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import typer
from typing_extensions import override

from crtk_drivers.cli.help_pages import HelpfulGroup, Listed
from crtk_drivers.cli.terminal import plain, sentence
from crtk_drivers.errors import PluginError
from crtk_drivers.errors.near_names import near_names
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

    @cached_property
    def _made(self) -> dict[str, Any]:
        return {}

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
        if entry is not None and cmd_name not in self._made:
            self._made[cmd_name] = self._command(entry)
        return self._made.get(cmd_name)

    @override
    def listed(self, ctx: Any, name: str) -> Listed | None:
        """Return how the command is listed: of a plugin with what is told of it, which may import nothing."""
        entry = self._plugins.get(name)
        if entry is None or name in super().list_commands(ctx):
            return super().listed(ctx, name)
        told = entry.description
        summary = sentence(told.summary) if told is not None else _BROKEN
        return Listed(_needs_extra(entry) or summary, self.source.panel)

    @override
    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]
        """Refuse an unknown name in our own words."""
        name = args[0]
        if not name.startswith("-") and self.get_command(ctx, name) is None:
            near = near_names(name, self.list_commands(ctx))
            if near and near[0] not in self._plugins:
                raise PluginError(
                    f"there is no command or device {name!r}",
                    remedy=f"Did you mean {near[0]!r}? `{ctx.command_path} --help` lists all.",
                )
            self.source.refuse(name)
        return super().resolve_command(ctx, args)

    def _command(self, entry: PluginEntry) -> Any:
        if entry.error is None:
            return self.source.build(entry.plugin, self.source.panel)
        return self._placeholder(entry)

    def _placeholder(self, entry: PluginEntry) -> Any:
        from crtk_drivers.cli.typed_options import make_command

        def run(**_: Any) -> int:
            assert entry.plugin is None  # raises
            return 1

        help_text = _needs_extra(entry) or _BROKEN
        return make_command(entry.name, run, [], help=help_text, panel=self.source.panel)


_BROKEN = "[red]broken, see [bold]crtk-driver list[/bold][/red]"


def _needs_extra(entry: PluginEntry) -> str:
    return f"[red]needs an extra: {plain(str(entry.missing))}[/red]" if entry.missing else ""
