"""What pages name of the product: commands with their options, and keys of settings."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

import typer
import yaml

from crtk_drivers import plugins
from crtk_drivers.cli.app import app, split_arguments
from crtk_drivers.config import with_node
from crtk_drivers.config.keys import annotation_of, setting_names
from crtk_drivers.labs.lab_file import LabSettings

__all__ = ["DEVICES_OF_PAGES", "Page", "wrong_command", "wrong_key"]

DEVICES_OF_PAGES: Final[Mapping[str, tuple[str, ...]]] = {
    "dvrk_controllers": ("dvrk",),
    "schunk": ("schunk", "schunk-fts", "ur"),
    "haptics": ("force-dimension", "openhaptics"),
    "inputs": ("inputs",),
    "motion": ("ur",),
    "first_day_ur": ("ur",),
    "first_day_dynamixel": ("dynamixel",),
    "first_day_canopen": ("canopen",),
    "first_day_sensor": ("ati-netft",),
    **{name: (name.replace("_", "-"), "ur") for name in ("onrobot", "robotiq", "weiss_wsg")},
}
"""The devices whose keys a page names, where its own name does not say it. Grippers hang at a UR, too."""

PLUGINS_OF_READERS: Final = frozenset(
    {"my_arm", "my_gripper", "my_scale", "my_sensor", "one_axis", "sartorius"}
)
"""Devices that are there only after a reader has installed them."""

_FENCE: Final = re.compile(r"^( *)```(\w*)\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
_INLINE: Final = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
_DOTTED: Final = re.compile(r"[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)+")
_SETTING: Final = re.compile(r"([a-z][a-z0-9_.]*): \S.*")
_COMMAND: Final = re.compile(
    r"^(?:\$ |next: )?(?:sudo )?(?:\w+=\S+ )*(?:uv run (?:--\S+(?: [\w.-]+)? )*)?(?:\S*/)?crtk-driver +(.*)$"
)
_EXPLAINED: Final = re.compile(r" {3,}|(?<= )\.\. ")
"""Between a command and what it does, in a list of commands."""
_ELLIPSIS: Final = frozenset({"...", "..", "…"})
_TAKES_PROGRAMS: Final = frozenset({"--run", "--test", "--pip"})
"""Options of the script in the repository, after which the command line of another program follows."""


class Page:
    """A page in Markdown."""

    def __init__(self, path: Path) -> None:
        self.name = path.stem
        text = path.read_text("utf-8")
        self._blocks = [(found[2], found[3]) for found in _FENCE.finditer(text)]
        prose = _FENCE.sub("", text)
        self._indented = [line[4:] for line in prose.splitlines() if line.startswith("    ")]
        self._inline = _INLINE.findall(prose)

    def commands(self) -> Iterator[str]:
        """Yield what is typed after ``crtk-driver``."""
        lines = [*self._indented, *self._inline]
        for language, block in self._blocks:
            if language in ("", "sh", "bash", "console"):
                lines += block.replace("\\\n", " ").splitlines()
        for line in lines:
            for part in re.split(r" (?:&&|;|\|) ", line):
                found = _COMMAND.match(part.strip())
                if found:
                    yield _EXPLAINED.split(found[1])[0]

    @property
    def devices(self) -> tuple[str, ...]:
        """The devices whose keys it names; none on a page about several."""
        own = self.name.removesuffix("_simulator").replace("_", "-")
        named = DEVICES_OF_PAGES.get(self.name, (own,))
        return tuple(name for name in named if name in plugins.devices())

    def named_keys(self) -> Iterator[tuple[str, ...]]:
        """Yield the keys that are named beyond doubt: in YAML of a device, and dotted ones in the text."""
        for language, block in self._blocks:
            if language == "yaml" and not self.name.endswith("_simulator"):
                yield from _paths(yaml.safe_load(block))
        tops = {table for name in self.devices for table in _tables(name)}
        for text in self._inline:
            dotted = _DOTTED.fullmatch(text)
            setting = _SETTING.fullmatch(text)
            key = tuple((setting[1] if setting else text).split("."))
            if (dotted or setting) and key[0] in tops:
                yield key

    def lab_files(self) -> Iterator[Mapping[str, Any]]:
        """Yield the lab files that it shows, whole or in part."""
        for language, block in self._blocks:
            if language == "toml":
                content = tomllib.loads(block)
                if "devices" in content:
                    yield content


def _paths(content: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    if isinstance(content, Mapping):
        for name, value in content.items():
            yield (*above, str(name))
            yield from _paths(value, (*above, str(name)))


@cache
def _model(device: str) -> Any:
    return with_node(plugins.device(device).config)


def _tables(device: str) -> set[str]:
    """Return the keys of a device that have keys of their own."""
    model = _model(device)
    return {key for key in setting_names(model) if setting_names(annotation_of(model, (key,)))}


def wrong_key(devices: Sequence[str], key: tuple[str, ...]) -> str:
    """Return what is wrong with a key of one of these devices, or of a lab file; empty if nothing is."""
    models = [LabSettings] if devices == ["lab"] else [_model(name) for name in devices]
    if any(annotation_of(model, key) is not None for model in models):
        return ""
    return f"{'.'.join(key)} is no key of {', '.join(devices)}"


def wrong_command(typed: str) -> str:
    """Return what is wrong with a command line; empty if nothing is.

    Args:
        typed: what follows ``crtk-driver``. Values are not judged.
    """
    try:
        words = shlex.split(typed, comments=True)
    except ValueError:
        words = typed.split()
    command = _root()
    path = "crtk-driver"
    context = _context(command)
    while words:
        word, *words = words
        if word in ("|", "&&", ";", ">", "&"):
            return ""
        if word in _TAKES_PROGRAMS:
            return ""
        if word == "--extra" and path == "crtk-driver":
            words = words[1:]
        elif word.startswith("--") and word != "--":
            name, _, value = word.partition("=")
            if name == "--ros-args":
                return ""
            if name not in _options(command) | {"--help", "--debug"}:
                return f"{path} has no option {name}"
            if not value and words and _takes_value(command, name):
                value, *words = words
            wrong = _wrong_setting(path, value) if name == "--set" else ""
            if wrong:
                return wrong
        elif path == "crtk-driver" and word in PLUGINS_OF_READERS:
            return ""
        elif hasattr(command, "list_commands") and word not in _ELLIPSIS:
            if not re.fullmatch(r"[a-z][a-z0-9_-]*", word):
                return ""  # a placeholder: <device>, NAME
            inner = command.get_command(context, word)
            if inner is None:
                return f"{path} has no command {word}"
            command, path = inner, f"{path} {word}"
            context = _context(command)
    return ""


@cache
def _root() -> Any:
    return typer.main.get_command(app)


@cache
def _context(command: Any) -> Any:
    return command.make_context("crtk-driver", [], obj=split_arguments([]), resilient_parsing=True)


def _options(command: Any) -> set[str]:
    return {name for each in command.params for name in (*each.opts, *each.secondary_opts)}


def _takes_value(command: Any, name: str) -> bool:
    return any(name in each.opts and not getattr(each, "is_flag", False) for each in command.params)


def _wrong_setting(path: str, setting: str) -> str:
    device = path.split()[-1]
    key = tuple(setting.partition("=")[0].split("."))
    if device not in plugins.devices() or not setting or setting in _ELLIPSIS:
        return ""
    return wrong_key([device], key)
