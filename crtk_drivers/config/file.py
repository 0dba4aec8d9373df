"""A TOML or YAML file as plain values, with the line of every key.

Safe against what a file may hold: size is capped, only regular files are read, YAML is read without
constructors, anchors and merge keys, and a key that is given twice is refused.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import yaml
from typing_extensions import override

from crtk_drivers.config.capped_file import read_capped
from crtk_drivers.errors import ConfigError

MAX_SIZE: Final = 256 * 1024
"""Largest file that is read, in bytes."""

Key = tuple[str | int, ...]
"""A key path: ``("limits", "max_step")``; numbers are positions in a list."""

Values = Mapping[str, Any]
Lines = Mapping[Key, int]


@dataclass(frozen=True)
class FileContent:
    """What a file says: nested values, and the line (from 1) of each key path."""

    values: Values
    lines: Lines


def read_file(path: Path) -> FileContent:
    """Read a ``.toml``, ``.yaml`` or ``.yml`` file.

    Raises:
        ConfigError: missing, not a regular file, too large, not text, or not valid in its format;
            with the line where that is known.
    """
    parse = _PARSERS.get(path.suffix.lower())
    if parse is None:
        raise ConfigError(
            f"{path.suffix or 'no suffix'!r} is not a known kind of configuration file",
            where=str(path),
            remedy=f"Name it {', '.join(_PARSERS)}.",
        )
    return parse(_read_text(path), str(path))


def parse_value(text: str, where: str) -> Any:
    """Return the value of `text` as YAML reads it: ``0.5``, ``true``, ``[1, 2]``, ``ur5e``.

    Raises:
        ConfigError: not a YAML value.
    """
    return parse_yaml(f"value: {text}", where).values["value"]


def _read_text(path: Path) -> str:
    data = read_capped(path, MAX_SIZE, "a configuration")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            "is not UTF-8 text", where=f"{path}:{line}", remedy="Save it as UTF-8."
        ) from None


class _Loader(yaml.SafeLoader):
    """The safe loader without aliases, by which a few lines become gigabytes."""

    @override
    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(
                None, None, "anchors and aliases are not supported", mark
            )
        return super().compose_node(parent, index)


def parse_yaml(text: str, name: str) -> FileContent:
    """Parse YAML text; `name` is the file for messages.

    Raises:
        ConfigError: not valid, a key given twice, or not a mapping at the top.
    """
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            if node is None:
                return FileContent(MappingProxyType({}), MappingProxyType({}))
            if not isinstance(node, yaml.MappingNode):
                raise ConfigError(
                    "holds no keys", where=name, remedy="Write one `key: value` a line."
                )
            lines: dict[Key, int] = {}
            _note_lines(node, (), lines, name)
            values = loader.construct_document(node)
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"{name}:{mark.line + 1}" if mark else name
        raise ConfigError(f"not valid YAML: {error.problem}", where=where) from None
    except yaml.YAMLError as error:
        raise ConfigError(f"not valid YAML: {str(error).splitlines()[0]}", where=name) from None
    except (ValueError, OverflowError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"holds an impossible value: {error}", where=name) from None
    except RecursionError:
        raise ConfigError("is nested too deeply", where=name) from None
    return FileContent(values, lines)


def _note_lines(node: yaml.Node, key: Key, lines: dict[Key, int], name: str) -> None:
    if isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            lines[*key, index] = item.start_mark.line + 1
            _note_lines(item, (*key, index), lines, name)
    elif isinstance(node, yaml.MappingNode):
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            where = f"{name}:{line}"
            if key_node.tag != "tag:yaml.org,2002:str":
                raise ConfigError(
                    f"the key {key_node.value!r} is not text", where=where, remedy="Quote it."
                )
            path = (*key, key_node.value)
            if path in lines:
                raise ConfigError(
                    f"the key {dotted(path)!r} is given twice, first on line {lines[path]}",
                    where=where,
                    remedy="Keep one.",
                )
            lines[path] = line
            _note_lines(value_node, path, lines, name)


_TOML_PLACE = re.compile(r" \(at (?:line (\d+), column \d+|end of document)\)$")
_TOML_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_TOML_KEY = re.compile(
    r"""\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*="""
)
_TOML_KEY_PART = re.compile(r"""[\w-]+|"[^"]*"|'[^']*'""")


def parse_toml(text: str, name: str) -> FileContent:
    """Parse TOML text; `name` is the file for messages.

    Raises:
        ConfigError: not valid TOML (which includes a key given twice).
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        place = _TOML_PLACE.search(message)
        line = place[1] if place and place[1] else text.rstrip().count("\n") + 1
        where = f"{name}:{line}"
        raise ConfigError(f"not valid TOML: {_TOML_PLACE.sub('', message)}", where=where) from None
    except ValueError as error:
        raise ConfigError(f"holds an impossible value: {error}", where=name) from None
    except RecursionError:
        raise ConfigError("is nested too deeply", where=name) from None
    return FileContent(values, _toml_lines(text))


def _toml_lines(text: str) -> Lines:
    """Find the line of each key by search: `tomllib` does not tell. For messages only."""
    lines: dict[Key, int] = {}
    table: Key = ()
    elements: dict[Key, int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _TOML_HEADER.match(line):
            table = _toml_key(header[2])
            if header[1] == "[[":
                index = elements.get(table, -1) + 1
                elements[table] = index
                table = (*table, index)
            lines.setdefault(table, number)
        elif assignment := _TOML_KEY.match(line):
            key = (*table, *_toml_key(assignment[1]))
            for length in range(len(table) + 1, len(key) + 1):
                lines.setdefault(key[:length], number)
    return lines


def _toml_key(text: str) -> Key:
    return tuple(part.strip("\"'") for part in _TOML_KEY_PART.findall(text))


def dotted(key: Key) -> str:
    """Return a key path as people write it: ``limits.max_step``, ``axes[0].upper``."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in key)
    return text.removeprefix(".")


_PARSERS: Mapping[str, Callable[[str, str], FileContent]] = MappingProxyType(
    {".yaml": parse_yaml, ".yml": parse_yaml, ".toml": parse_toml}
)
