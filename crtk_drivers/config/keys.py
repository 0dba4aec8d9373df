"""What keys a configuration has, of which types, and what they are for: read off its `Settings` class."""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel

from crtk_drivers.config.file import Key


def all_keys(model: type, prefix: Key = ()) -> Iterator[Key]:
    """Yield the keys of all tables."""
    for name in setting_names(model):
        yield (*prefix, name)
        inner = annotation_of(model, (name,))
        if isinstance(inner, type) and inner is not model:
            yield from all_keys(inner, (*prefix, name))


def setting_names(model: Any) -> tuple[str, ...]:
    """Return the keys of a `Settings` class or dataclass, none for anything else."""
    if isinstance(model, type) and issubclass(model, BaseModel):
        return tuple(model.model_fields)
    if isinstance(model, type) and is_dataclass(model):
        return tuple(model.__dataclass_fields__)
    return ()


def heading_of(model: type, name: str) -> str:
    """Return the heading under which a key stands in a help page; empty if it has none.

    A configuration class groups its keys by ``HEADINGS``, a mapping of headings to names of keys; one that
    it is derived from may have one of its own.
    """
    for each in model.__mro__:
        for heading, names in vars(each).get("HEADINGS", {}).items():
            if name in names:
                return str(heading)
    return ""


def annotation_of(model: Any, key: Key) -> Any:
    """Return the type that `key` has in `model`; None if there is no such key.

    ``X | None`` counts as X, and a position in a list as the list's element.
    """
    for part in key:
        if isinstance(part, int):
            model = next(iter(get_args(model)), None)
        elif part in setting_names(model):
            model = _plain(get_type_hints(model)[part])
        elif get_origin(model) in (dict, Mapping) or _is_mapping(get_origin(model)):
            model = _plain(get_args(model)[1])
        else:
            return None
    return model


def _is_mapping(origin: Any) -> bool:
    return isinstance(origin, type) and issubclass(origin, Mapping)


def _plain(annotation: Any) -> Any:
    if get_origin(annotation) in (Union, types.UnionType):
        inner = [arg for arg in get_args(annotation) if arg is not types.NoneType]
        return inner[0] if len(inner) == 1 else annotation
    return annotation


def takes_text(annotation: Any) -> bool:
    """Whether a value of this type may be text: str, a Literal of texts, or a union with one."""
    if annotation is str or isinstance(annotation, str):
        return True
    if isinstance(annotation, type):
        return issubclass(annotation, str)
    if get_origin(annotation) in (Literal, Union, types.UnionType):
        return any(takes_text(argument) for argument in get_args(annotation))
    return False


def choices_of(annotation: Any) -> tuple[Any, ...]:
    """Return the values of a Literal, none for any other type."""
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def description_of(model: Any, key: Key) -> str:
    """Return the description of `key`, empty if it has none."""
    if not key or isinstance(key[-1], int):
        return ""
    table = annotation_of(model, key[:-1])
    if key[-1] not in setting_names(table):
        return ""
    if issubclass(table, BaseModel):
        return table.model_fields[key[-1]].description or ""
    metadata = table.__dataclass_fields__[key[-1]].metadata
    return str(metadata.get("help", ""))
