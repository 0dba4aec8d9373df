"""The methods of values: ``list.append(1)`` and its like, and those of handles.

Source: URScript manual of PolyScope 5.15 and later, "Lists and Structs".
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Generator
from typing import Any

from crtk_sim_backends.ur.urscript.errors import ScriptRuntimeError
from crtk_sim_backends.ur.urscript.values import (
    Handle,
    List,
    Struct,
    arguments_taken,
    check_weight,
    copy_value,
    is_matrix,
    limited,
    to_text,
    wrong_type,
)


def call_method(
    value: Any, name: str, /, *arguments: Any, **keywords: Any
) -> Generator[None, None, Any]:
    """Call a method of a value; a generator, because that of a handle may wait."""
    if isinstance(value, Handle):
        return (yield from value.call(name, arguments, keywords))
    method = _LIST_METHODS.get(name) if isinstance(value, List) else None
    if method is None:
        wrong_type(f"a value has no method {name}")
    try:
        inspect.signature(method).bind(value, *arguments, **keywords)
    except TypeError:
        wrong_type(f"{name} {arguments_taken(method, own=1)}")
    return method(value, *arguments, **keywords)


def _room(values: List, *elements: Any) -> None:
    """Fix the capacity of a list that is about to change, and see that it suffices."""
    if is_matrix(values):
        wrong_type("the size of a matrix cannot be changed")
    values.most = values.capacity
    if len(values) + len(elements) > values.most:
        raise ScriptRuntimeError(f"List capacity exceeded: {values.most}")
    if any(isinstance(element, List | Struct) for element in elements):
        check_weight(values, *elements)


def _position(values: List, index: Any, end: int) -> int:
    if not 0 <= index < end:
        raise ScriptRuntimeError("Index out of range")
    return int(index)


def _append(values: List, element: Any) -> None:
    _room(values, element)
    values.append(copy_value(element))


def _extend(values: List, elements: List) -> None:
    if not isinstance(elements, List):
        wrong_type("extend takes a list")
    _room(values, *elements)
    values.extend(elements.copy())


def _insert(values: List, index: int, element: Any) -> None:
    position = _position(values, index, len(values) + 1)
    _room(values, element)
    values.insert(position, copy_value(element))


def _pop(values: List) -> Any:
    _room(values)
    return values.pop()


def _remove(values: List, index: int) -> None:
    position = _position(values, index, len(values))
    _room(values)
    del values[position]


def _clear(values: List) -> None:
    _room(values)
    values.clear()


def _slice(values: List, begin_index: int = 0, end_index: int | None = None) -> List:
    end = len(values) if end_index is None else _position(values, end_index, len(values) + 1)
    return List(values[_position(values, begin_index, end + 1) : end])


_LIST_METHODS: dict[str, Callable[..., Any]] = {
    "append": _append,
    "capacity": lambda values: values.capacity,
    "clear": _clear,
    "excess_capacity": lambda values: values.capacity - len(values),
    "extend": _extend,
    "insert": _insert,
    "length": lambda values: len(values),
    "pop": _pop,
    "remove": _remove,
    "slice": _slice,
    "to_string": lambda values: limited(to_text(values)),
}
