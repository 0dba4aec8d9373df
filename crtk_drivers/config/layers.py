"""The layers of a configuration, and how they become one: defaults, file, command line.

`load` merges them and puts all that is wrong in one `ConfigError`, with file, line, key, what was expected,
and what was probably meant.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from crtk_drivers.config.file import Key, Values, dotted, parse_value, read_file
from crtk_drivers.config.keys import (
    all_keys,
    annotation_of,
    choices_of,
    description_of,
    setting_names,
    takes_text,
)
from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.near_names import near_names


@dataclass(frozen=True)
class Layer:
    """Values from one source, and where each key was written: ``ur.yaml:7`` or ``--host``."""

    values: Values
    source: str
    places: Mapping[Key, str] = field(default_factory=dict)

    def says(self, key: Key) -> bool:
        """Whether `key` was given a value that is not empty."""
        values: Any = self.values
        for part in key:
            values = values.get(part) if isinstance(values, Mapping) else None
        return values not in (None, "")

    def place(self, key: Key) -> str:
        """Return where `key`, or the table that holds it, was written."""
        for length in range(len(key), 0, -1):
            if key[:length] in self.places:
                return self.places[key[:length]]
        return self.source


def from_file(path: str | Path) -> Layer:
    """Return the layer of a TOML or YAML file.

    Raises:
        ConfigError: the file cannot be used; see `crtk_drivers.config.file.read_file`.
    """
    content = read_file(Path(path))
    places = {key: f"{path}:{line}" for key, line in content.lines.items()}
    return Layer(content.values, str(path), places)


def from_values(values: Values, source: str = "arguments") -> Layer:
    """Return a layer of values that a program gives."""
    return Layer(values, source)


def from_assignments(model: type, assignments: Iterable[str], option: str = "--set") -> Layer:
    """Return the layer of texts such as ``limits.max_step=0.2``; values are read as YAML.

    Args:
        model: a `Settings` class or a dataclass: a key that takes text gets the text as it is.
        assignments: ``key=value``; a later one overrides an earlier one.
        option: the option that they were given with, for messages.

    Raises:
        ConfigError: an assignment without ``=`` or with an empty key, or a value that is not YAML.
    """
    values: dict[str, Any] = {}
    places: dict[Key, str] = {}
    for assignment in assignments:
        path, equals, text = assignment.partition("=")
        key: Key = tuple(part.strip() for part in path.split("."))
        place = f"{option} {assignment}"
        if not equals or not all(key):
            raise ConfigError(
                "is not of the form key=value",
                where=place,
                remedy=f"For example: {option} limits.max_step=0.2",
            )
        table = values
        for part in map(str, key[:-1]):
            if not isinstance(table.get(part), dict):
                table[part] = {}
            table = table[part]
        table[str(key[-1])] = typed_value(model, key, text, place)
        places |= {key[:length]: place for length in range(1, len(key) + 1)}
    return Layer(values, option, places)


def typed_value(model: type, key: Key, text: str, place: str) -> Any:
    """Return `text` as the key wants it: as it is for text, otherwise read as YAML."""
    value = parse_value(text, place)
    return value if value is None or not takes_text(annotation_of(model, key)) else text


Config = TypeVar("Config")


def load(model: type[Config], *layers: Layer) -> Config:
    """Merge the layers, later ones over earlier ones, and make a `model` of them.

    Args:
        model: a `Settings` class, or any dataclass (the options of a simulator).
        layers: see `from_file`, `from_assignments`, `from_values`.

    Raises:
        ConfigError: with every mistake in it.
    """
    merged = values_of(*layers)
    # pydantic itself lets a dataclass pass with keys that it does not have.
    names = setting_names(model)
    problems = (
        []
        if issubclass(model, BaseModel)
        else [_unknown_key(model, (key,), layers) for key in merged if key not in names]
    )
    problems += [
        _flag_as_number(model, key, layers) for key in _flags(merged) if _counts(model, key)
    ]
    try:
        made = TypeAdapter(model).validate_python(merged)
    except ValidationError as error:
        problems += [_problem(model, details, layers) for details in error.errors()]
    if not problems:
        return made
    if len(problems) == 1:
        raise problems[0]
    raise ConfigError(
        f"{len(problems)} mistakes in the configuration:\n"
        + "\n".join(f"  {problem}" for problem in problems)
    )


def values_of(*layers: Layer) -> dict[str, Any]:
    """Return what the layers say together, later ones over earlier ones, key by key."""
    merged: dict[str, Any] = {}
    for layer in layers:
        merged = _merged(merged, layer.values)
    return merged


def _merged(below: Values, above: Values) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        present = merged.get(key)
        both = isinstance(present, Mapping) and isinstance(value, Mapping)
        merged[key] = _merged(present, value) if both else value  # type: ignore[arg-type]
    return merged


def _flags(values: Any, key: Key = ()) -> Iterator[Key]:
    """Yield the keys that hold true or false."""
    if isinstance(values, bool):
        yield key
    elif isinstance(values, Mapping):
        for name, value in values.items():
            yield from _flags(value, (*key, name))
    elif isinstance(values, list | tuple):
        for index, value in enumerate(values):
            yield from _flags(value, (*key, index))


def _counts(model: type, key: Key) -> bool:
    """Whether a key takes a number: pydantic would take true for 1."""
    return annotation_of(model, key) in (int, float)


def _flag_as_number(model: type, key: Key, layers: Sequence[Layer]) -> ConfigError:
    return ConfigError(
        **_about(layers, key, "must be a number, not true or false"),
        remedy=description_of(model, key),
    )


_MISSING = frozenset({"missing", "missing_argument", "missing_keyword_only_argument"})

_EXPECTED = {
    "model_type": "must be a table of keys",
    "dict_type": "must be a table of keys",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "string_type": "must be text (in quotes)",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
}
"""What is expected in the words of this package, where pydantic speaks of its own types."""


def _problem(model: type, details: ErrorDetails, layers: Sequence[Layer]) -> ConfigError:
    key: Key = details["loc"]
    if details["type"] == "extra_forbidden":
        return _unknown_key(model, key, layers)
    if details["type"] in _MISSING:
        return ConfigError(
            f"{dotted(key)}: is required",
            where=_place(layers, key[:-1]),
            remedy=description_of(model, key),
        )
    key = _existing(layers, key)
    text = details["msg"].removeprefix("Value error, ")
    text = _EXPECTED.get(details["type"], text.replace("Input should", "must"))
    if details["type"] != "value_error":
        text = f"{text}, not {_short(details['input'])}"
    choices = [str(choice) for choice in choices_of(annotation_of(model, key))]
    meant = _closest(str(details["input"]), choices)
    remedy = f"Did you mean {meant!r}?" if meant else description_of(model, key)
    return ConfigError(**_about(layers, key, text), remedy=remedy)


def _unknown_key(model: type, key: Key, layers: Sequence[Layer]) -> ConfigError:
    meant = _suggested_key(model, key)
    remedy = f"Did you mean {meant!r}?" if meant else _known_keys(model, key)
    return ConfigError(f"{dotted(key)}: unknown key", where=_place(layers, key), remedy=remedy)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _holds(values: Any, key: Key) -> bool:
    for part in key:
        if isinstance(values, list | tuple):
            values = dict(enumerate(values))
        if not isinstance(values, Mapping) or part not in values:
            return False
        values = values[part]
    return True


def _existing(layers: Sequence[Layer], key: Key) -> Key:
    """Return `key` without the tail that names no key but an alternative of a type."""
    while key and not any(_holds(layer.values, key) for layer in layers):
        key = key[:-1]
    return key


def _about(layers: Sequence[Layer], key: Key, text: str) -> dict[str, str]:
    """Return message and place of what is wrong with a key, which an option names already."""
    place = _place(layers, key)
    named = not key or place == "--" + dotted(key).replace("_", "-")
    return {"message": text if named else f"{dotted(key)}: {text}", "where": place}


def _place(layers: Sequence[Layer], key: Key) -> str:
    for layer in reversed(layers):
        if key and _holds(layer.values, key):
            return layer.place(key)
    return layers[0].source if layers else "configuration"


def _closest(word: str, words: Iterable[str]) -> str:
    return next(iter(near_names(word, words)), "")


def _suggested_key(model: type, key: Key) -> str:
    """Return the key that was probably meant: that name elsewhere, or one like it here, or there."""
    last = str(key[-1])
    elsewhere = {str(path[-1]): dotted(path) for path in all_keys(model)}
    if last in elsewhere:
        return elsewhere[last]
    if meant := _closest(last, setting_names(annotation_of(model, key[:-1]))):
        return dotted((*key[:-1], meant))
    return elsewhere.get(_closest(last, elsewhere), "")


def _known_keys(model: type, key: Key) -> str:
    names = setting_names(annotation_of(model, key[:-1]))
    return f"Known keys: {', '.join(names)}." if names else ""
