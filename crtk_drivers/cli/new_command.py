"""``crtk-driver new <kind> <name>``: a plugin to start from, which passes its tests.

The templates are plugins themselves (``crtk_drivers/cli/templates``), called ``my_sensor`` and so on: a new
one is a copy in which that name is replaced.
"""

from __future__ import annotations

import keyword
import re
import shlex
from collections.abc import Iterator
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from typing_extensions import override

from crtk_drivers import plugins
from crtk_drivers.cli.help_pages import HelpfulCommand, completed_from
from crtk_drivers.cli.own_commands import OWN_COMMANDS
from crtk_drivers.cli.terminal import OUT
from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.errors.wording import current_wording, worded

app = typer.Typer()

TEMPLATES: Final = Path(__file__).with_name("templates")

LONGEST: Final = 40
"""Characters of a name: lines of the templates stay as short as they have to be."""

_LEFT_OUT: Final = ("__pycache__", ".pytest_cache", ".ruff_cache", ".mypy_cache")


class Kind(StrEnum):
    """What kinds of plugins there are to start from; each is a folder of `TEMPLATES`."""

    SENSOR = "sensor"
    ARM = "arm"
    GRIPPER = "gripper"


_EXAMPLES: Final = {Kind.SENSOR: "my_scale", Kind.ARM: "my_robot", Kind.GRIPPER: "my_hand"}
"""Names for them that anybody may use."""


class _NewCommand(HelpfulCommand):
    """The command, which answers wrong words with what can be given."""

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read kind and name."""
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as error:
            missing = getattr(error.param, "name", "")
            if missing not in ("kind", "name"):
                raise
            what = "a name is missing" if missing == "name" else "a kind and a name are missing"
            raise _wrong(what, ctx.params.get("kind") or "") from None


def _wrong(what: str, kind: str = "") -> ConfigError:
    """Return what is wrong with the words that were given, with what can be given."""
    meant = next(iter(near_names(kind, Kind)), None)
    hint = f"Did you mean {meant}? " if meant and meant != kind else ""
    example = f"crtk-driver new {meant or Kind.SENSOR} {_EXAMPLES[Kind(meant or Kind.SENSOR)]}"
    return ConfigError(
        what,
        where="new",
        remedy=f"{hint}Give one of {', '.join(Kind)}, and one name. For example: {example}",
    )


@app.command("new", cls=_NewCommand, context_settings={"allow_extra_args": True})
def _new(
    context: typer.Context,
    kind: Annotated[
        str,
        typer.Argument(
            help=f"What it is like: {', '.join(Kind)}.",
            show_default=False,
            autocompletion=completed_from(lambda: Kind),
        ),
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
    if kind not in tuple(Kind):
        raise _wrong(f"there is no template {kind!r}", kind)
    if context.args:
        raise _wrong(f"too many words: {' '.join(context.args)}", kind)
    raise typer.Exit(write_plugin(Kind(kind), name, directory))


def write_plugin(kind: Kind, name: str, parent: Path) -> int:
    """Write a plugin into a new folder of `parent`, and say what to do next.

    Args:
        kind: which template.
        name: of the device, as in ``crtk-driver <name>``.
        parent: an existing folder.

    Raises:
        ConfigError: the name cannot be used or is taken, or the folder is there; nothing is written.
    """
    check_name(name)
    folder = parent / f"crtk-driver-{name.replace('_', '-')}"
    if folder.exists():
        raise ConfigError(
            "is there already, and nothing of it is overwritten",
            where=str(folder),
            remedy="Choose another name, or another folder with --directory.",
        )
    try:
        for path, text in contents(kind, name):
            target = folder / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            f"cannot be written: {error.strerror}",
            where=str(folder),
            remedy="Choose a folder that you may write to with --directory.",
        ) from error
    OUT.print(_next_steps(folder, name), markup=False, highlight=False, soft_wrap=True)
    return 0


def contents(kind: Kind, name: str) -> Iterator[tuple[str, str]]:
    """Yield the files of a plugin: path in its folder, and text."""
    template = TEMPLATES / kind
    for path in sorted(template.rglob("*")):
        inside = path.relative_to(template)
        if path.is_file() and not set(inside.parts) & set(_LEFT_OUT):
            yield _renamed(str(inside), kind, name), _renamed(path.read_text("utf-8"), kind, name)


def _renamed(text: str, kind: Kind, name: str) -> str:
    """Replace the name of a template, in each way in which it is written."""
    title = "".join(word.capitalize() for word in name.split("_"))
    return (
        text.replace(f"my_{kind}", name)
        .replace(f"my-{kind}", name.replace("_", "-"))
        .replace(f"My{kind.capitalize()}", title)
    )


def check_name(name: str) -> None:
    """Make sure that a device may be called so.

    Raises:
        ConfigError: with the reason, and what can be given instead.
    """
    plain = re.sub(r"_+", "_", re.sub(r"[^a-z0-9]", "_", name.lower())).strip("_")[:LONGEST]
    wrong = (
        "is no name for Python modules: small letters, digits and single underscores, a letter first"
        if not re.fullmatch(r"[a-z](?:_?[a-z0-9])*", name)
        else f"has more than {LONGEST} characters"
        if len(name) > LONGEST
        else "is a word of Python"
        if keyword.iskeyword(name) or keyword.issoftkeyword(name)
        else ""
    )
    if wrong:
        usable = plain[:1].isalpha() and not keyword.iskeyword(plain) and plain != name
        raise ConfigError(
            wrong, where=repr(name), remedy=f"Call it {plain}." if usable else "Choose another."
        )
    taken = _taken_by(name)
    if taken:
        raise ConfigError(
            f"is taken: {taken}",
            where=repr(name),
            remedy="Choose another; `crtk-driver list` shows those that are there.",
        )


def _taken_by(name: str) -> str:
    """Return who has a name already; empty: nobody."""
    if name in OWN_COMMANDS:
        return f"`crtk-driver {name}` is a command"
    for what, entries in (("device", plugins.devices()), ("simulator", plugins.sims())):
        for entry in entries.values():
            if entry.name.partition("@")[0].replace("-", "_") == name:
                return f"{entry.distribution or 'a package'} has a {what} of that name"
    for module in (f"crtk_driver_{name}", f"crtk_sim_{name}"):
        if find_spec(module) is not None:
            return f"there is a module {module}"
    return ""


def _next_steps(folder: Path, name: str) -> str:
    shown = folder if folder.is_absolute() else f"./{folder}"
    plugin = shlex.quote(str(shown))
    steps = f"""Written to {folder}. What to do next:

  pip install -e {shlex.quote(f"{shown}[test]")}
  crtk-driver list {name}
  {current_wording().run}pytest {plugin}
  crtk-driver {name} --ns /{name} --sim

Then make its protocol that of your device: README.md tells what to change, in which order.
How a plugin works: docs/adding_a_device.md of crtk-drivers."""
    return worded(steps)
