"""Help pages: headings, names that are never cut, descriptions beside or below them.

A terminal of any width, and a pipe, get the same words: a name that leaves no room beside it stands in a line
of its own. Commands and groups get these pages by their class, `HelpfulCommand` or `HelpfulGroup`; the first
also has Ctrl-C raise KeyboardInterrupt while the command runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from rich.padding import Padding
from rich.text import Text
from typer.core import TyperCommand, TyperGroup
from typing_extensions import override

from crtk_drivers.cli.terminal import OUT
from crtk_drivers.errors.wording import worded
from crtk_drivers.status.stop_request import raised_at_interrupt

WIDEST: Final = 100
"""Columns that a page takes at most."""
_NAMES: Final = 28
"""Columns for names with a description beside them."""
_NARROWEST: Final = 24
"""Columns that a description needs to stand beside a name."""

Rows = list[tuple[Text, Text]]


@dataclass(frozen=True)
class Listed:
    """A command as the page of its group lists it: a summary, which is markup, and the heading above it."""

    summary: str
    panel: str


@dataclass(frozen=True)
class Completion:
    """What a shell may complete a word to, with its explanation: click reads these names."""

    value: str
    help: str
    type: str = "plain"


def completed_from(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return what a shell's completion calls for a value that is one of `names`."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


class _StableNames:
    """The names of the help option in one order: click has them from a set."""

    def get_help_option_names(self, ctx: Any) -> list[str]:
        """Return them, the long one first."""
        return sorted(super().get_help_option_names(ctx))  # type: ignore[misc]


class HelpfulCommand(_StableNames, TyperCommand):
    """A command with such a page."""

    @override
    def invoke(self, ctx: Any) -> Any:
        """Run it; what it has opened is closed at Ctrl-C."""
        with raised_at_interrupt():
            return super().invoke(ctx)

    @override
    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the page."""
        print_page(self, ctx)


class HelpfulGroup(_StableNames, TyperGroup):
    """A group of commands with such a page."""

    def listed(self, ctx: Any, name: str) -> Listed | None:
        """Return how the command `name` is listed; None if it is not."""
        command: Any = self.get_command(ctx, name)
        if command is None or command.hidden:
            return None
        return Listed((command.help or "").split("\n\n")[0], _panel(command))

    def more_sections(self) -> Mapping[str, Rows]:
        """Return what its page has below its options, by heading."""
        return {}

    @override
    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Return the commands that begin so, as they are listed: no module is imported for it."""
        if incomplete.startswith("-"):
            return super().shell_complete(ctx, incomplete)
        names = [name for name in self.list_commands(ctx) if name.startswith(incomplete)]
        listed = ((name, self.listed(ctx, name)) for name in names)
        return [
            Completion(name, Text.from_markup(row.summary, emoji=False).plain)
            for name, row in listed
            if row is not None
        ]

    @override
    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the page."""
        print_page(self, ctx)


def print_page(command: Any, ctx: Any) -> None:
    """Print the help page of a command or group."""
    width = min(OUT.width, WIDEST)
    parts: list[Any] = [Text.assemble(("Usage: ", "bold"), _usage(command, ctx)), Text()]
    for paragraph in worded(command.help or "").split("\n\n"):
        parts += _paragraph(paragraph)
    for heading, rows in _sections(command, ctx).items():
        parts += [Text(f"{heading}:", "bold"), *_lines(rows, width), Text()]
    if command.epilog:
        parts.append(Text.from_markup(worded(command.epilog), emoji=False))
    for part in parts:
        if getattr(part, "no_wrap", False):
            OUT.print(part, soft_wrap=True)
        else:
            OUT.print(part, width=width)


def _usage(command: Any, ctx: Any) -> str:
    arguments = [
        _metavar(each) if each.required else f"[{_metavar(each)}]"
        for each in command.params
        if each.param_type_name == "argument"
    ]
    words = [ctx.command_path, "[OPTIONS]", *arguments]
    if isinstance(command, TyperGroup):
        words.append("[COMMAND ...]" if command.invoke_without_command else "COMMAND ...")
    return worded(" ".join(words))


def _paragraph(text: str) -> Iterator[Text | Padding]:
    if not text.strip():
        return
    if text.startswith("  "):  # an example: as it stands
        for line in text.splitlines():
            yield Text(f"  {line.strip()}", "cyan", no_wrap=True)
    else:
        yield Text.from_markup(" ".join(text.split()), emoji=False)
    yield Text()


def _sections(command: Any, ctx: Any) -> Mapping[str, Rows]:
    sections: dict[str, Rows] = {}
    for param in command.get_params(ctx):
        if getattr(param, "hidden", False):
            continue
        argument = param.param_type_name == "argument"
        heading = _panel(param) or ("Arguments" if argument else "Options")
        names = Text(_metavar(param), "cyan") if argument else _option_names(param)
        sections.setdefault(heading, []).append((names, _description(param)))
    if isinstance(command, HelpfulGroup):
        sections |= command.more_sections()
        for name in command.list_commands(ctx):
            told = command.listed(ctx, name)
            if told is not None:
                summary = Text.from_markup(worded(" ".join(told.summary.split())), emoji=False)
                row = Text(name, "cyan"), summary
                sections.setdefault(told.panel or "Commands", []).append(row)
    return sections


def _panel(thing: Any) -> str:
    panel = getattr(thing, "rich_help_panel", "")
    return panel if isinstance(panel, str) else ""


def _metavar(param: Any) -> str:
    return str(param.metavar or param.name.upper())


def _option_names(param: Any) -> Text:
    names = Text(", ".join([*param.opts, *param.secondary_opts]), "cyan")
    if not param.is_flag and not getattr(param, "count", False):
        names.append(f" {_metavar(param)}", "yellow")
    return names


def _description(param: Any) -> Text:
    text = Text.from_markup(worded(param.help or ""), emoji=False)
    default = param.default
    shown = getattr(param, "show_default", False) and isinstance(default, str | int | float)
    if shown and not isinstance(default, bool) and default != "":
        shown_default = f"{default:g}" if isinstance(default, float) else default
        text.append(f" [default: {shown_default}]", "dim")
    return text


def _lines(rows: Rows, width: int) -> Iterable[Text | Padding]:
    """Yield rows of names and descriptions; the second column begins where the names leave room."""
    beside = [len(names) for names, _ in rows if len(names) <= _NAMES]
    column = max(beside, default=4) + 4
    if width - column < _NARROWEST:
        column = min(8, width // 4)
    for names, description in rows:
        lines = list(description.wrap(OUT, max(width - column, 1)))
        first = Text("  ", no_wrap=True).append_text(names)
        if lines and len(first) + 2 <= column:
            first.append(" " * (column - len(first))).append_text(lines.pop(0))
        yield first
        for line in lines:
            yield Padding(line, (0, 0, 0, column), expand=False)
