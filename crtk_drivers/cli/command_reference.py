"""Tables of what a device offers, in pages of the documentation, made of its declared capabilities.

A page holds them between ``<!-- commands of ur -->`` and ``<!-- end -->``.

python -m crtk_drivers.cli.command_reference docs/ur.md            # writes the tables of these pages
python -m crtk_drivers.cli.command_reference --check docs/ur.md    # 1 if one is out of date
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from crtk_drivers import plugins
from crtk_drivers.cli.written_files import write_or_check, writer_parser
from crtk_drivers.commands import Command, Direction, Level, Space

_MARKED: Final = re.compile(
    r"(?P<begin><!-- commands of (?P<device>[\w-]+) -->\n).*?(?=<!-- end -->)", re.DOTALL
)
_HEAD: Final = "| | joint | Cartesian |\n|---|---|---|\n"
_ROWS: Final = (
    ("feedback", (Level.MEASURED, Level.SETPOINT, Level.GOAL)),
    ("stream", (Level.SERVO,)),
    ("slow stream", (Level.INTERPOLATE,)),
    ("go there", (Level.MOVE,)),
    ("state", (Level.STATE,)),
    ("settings", (Level.SETTING,)),
    ("queries", (Level.QUERY,)),
)


def table(commands: Mapping[str, Command]) -> str:
    """Return the table of the commands outside of sub-namespaces, as Markdown."""
    return _HEAD + "".join(_lines([each for each in commands.values() if not _is_inside(each)]))


def _is_inside(command: Command) -> bool:
    return "/" in command.name and command.level is not Level.SETTING


def _lines(commands: Sequence[Command]) -> Iterator[str]:
    for title, levels in _ROWS:
        row = [each for each in commands if each.level in levels]
        if row:
            joint, cartesian = (
                " ".join(f"`{_shown(each)}`" for each in row if (each.space is space) is wanted)
                for space, wanted in ((Space.CARTESIAN, False), (Space.CARTESIAN, True))
            )
            yield f"| {title} | {joint} | {cartesian} |\n"


def _shown(command: Command) -> str:
    return f"{command.name}()" if command.direction is Direction.SERVICE else command.name


def updated(page: str) -> str:
    """Return a page with its tables as the devices are now.

    Raises:
        PluginError, MissingExtra: there is no such device, or it cannot be loaded.
    """
    return _MARKED.sub(
        lambda found: f"{found['begin']}\n{table(plugins.commands_of(found['device']))}\n", page
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the tables of pages, or check them; return the exit code."""
    module = __spec__.name
    parser = writer_parser(module, "Tables of what devices offer.")
    parser.add_argument("pages", nargs="+", type=Path)
    options = parser.parse_args(arguments)
    texts = {page: updated(page.read_text(encoding="utf-8")) for page in options.pages}
    return write_or_check(texts, only_check=options.check, module=module, given=texts)


if __name__ == "__main__":
    sys.exit(main())
