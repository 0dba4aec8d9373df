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
from typing import Annotated, Any, Final, NamedTuple

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


class Link(StrEnum):
    """By what kinds of lines the device of a template may be connected."""

    SERIAL = "serial"
    TCP = "tcp"
    UDP = "udp"


VARIANTS: Final = TEMPLATES / "variants"
"""Files in place of those of a template: folders for each kind, by line, `NETWORK` and `STREAMS`."""

STREAMS: Final = "streams"

NETWORK: Final = "network"
"""Folder of what TCP and UDP have in common."""

LINKS: Final = {Kind.SENSOR: tuple(Link), Kind.ARM: (Link.TCP,), Kind.GRIPPER: (Link.SERIAL,)}
"""What there is for each kind, that which is taken where nothing is said first."""

STREAMING: Final = {Kind.SENSOR: (False, True), Kind.ARM: (True,), Kind.GRIPPER: (False,)}
"""Whether the device sends by itself: what there is for each kind, in the same order."""

_PARTS: Final = ("link.md", "protocol.md")
"""Parts of a README, which has their names in comments."""

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
    link: Annotated[
        Link | None,
        typer.Option(help="How a sensor is connected; a serial line if not given."),
    ] = None,
    streams: Annotated[
        bool,
        typer.Option("--streams", help="The sensor sends by itself; it is not asked each time."),
    ] = False,
) -> None:
    """Write a plugin for a device of your own: driver, simulator and tests to start from, which pass.

    A folder crtk-driver-NAME is made; nothing is overwritten. For example: crtk-driver new sensor my_scale
    or, for a sensor that streams over the network: crtk-driver new sensor my_scale --link udp --streams
    """
    if kind not in tuple(Kind):
        raise _wrong(f"there is no template {kind!r}", kind)
    if context.args:
        raise _wrong(f"too many words: {' '.join(context.args)}", kind)
    variant = _variant(Kind(kind), link, streams)
    raise typer.Exit(write_plugin(variant, name, directory))


class Variant(NamedTuple):
    """Which template, and which of its variants."""

    kind: Kind
    link: Link
    streams: bool

    @property
    def folders(self) -> Iterator[Path]:
        """Where its files are; those of a later folder take the place of others."""
        yield TEMPLATES / self.kind
        if self.link is not LINKS[self.kind][0]:
            if self.link is not Link.SERIAL:
                yield VARIANTS / self.kind / NETWORK
            yield VARIANTS / self.kind / self.link
        if self.streams is not STREAMING[self.kind][0]:
            yield VARIANTS / self.kind / STREAMS


def _variant(kind: Kind, link: Link | None, streams: bool) -> Variant:
    links, streaming = LINKS[kind], STREAMING[kind]
    if link is not None and link not in links:
        raise ConfigError(
            f"there is no template of one with --link {link}",
            where=f"new {kind}",
            remedy=f"Leave it out: it has {' or '.join(links)}. To change that, take another transport of "
            "crtk_drivers.kit in its device.py: TcpTransport, UdpTransport, serial_port.SerialPort.",
        )
    if streams and True not in streaming:
        raise ConfigError(
            "there is no template of one with --streams",
            where=f"new {kind}",
            remedy="Leave it out: it is asked once a cycle, and need not send by itself.",
        )
    return Variant(kind, link or links[0], streams or streaming[0])


def variants() -> Iterator[Variant]:
    """Yield all that there is to start from."""
    for kind in Kind:
        for link in LINKS[kind]:
            for streams in STREAMING[kind]:
                yield Variant(kind, link, streams)


def write_plugin(variant: Variant, name: str, parent: Path) -> int:
    """Write a plugin into a new folder of `parent`, and say what to do next.

    Args:
        variant: which template.
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
        for path, text in contents(variant, name):
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


def contents(variant: Variant, name: str) -> Iterator[tuple[str, str]]:
    """Yield the files of a plugin: path in its folder, and text."""
    found: dict[str, str] = {}
    for folder in variant.folders:
        for path in sorted(folder.rglob("*")):
            inside = path.relative_to(folder)
            if path.is_file() and not set(inside.parts) & set(_LEFT_OUT):
                found[str(inside)] = path.read_text("utf-8")
    for part in _PARTS:
        text = found.pop(part, "").rstrip()
        found["README.md"] = found["README.md"].replace(f"<!-- {part} -->", text)
    if Link.SERIAL is not variant.link:
        found["pyproject.toml"] = found["pyproject.toml"].replace(
            "crtk-drivers[serial]", "crtk-drivers"
        )
    for where, text in found.items():
        yield _renamed(where, variant.kind, name), _renamed(text, variant.kind, name)


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
