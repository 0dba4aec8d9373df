"""ROS messages of any type as plain data, and plain data into requests, for what CRTK has no value for."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Any

import numpy as np

from crtk_drivers.errors import ConfigError


def message_class(ros_type: str) -> type:
    """Return the class of a message or service by its name on ROS: ``std_srvs/srv/Trigger``.

    Raises:
        ConfigError: its package is not installed here.
    """
    package, kind, name = ros_type.split("/")
    try:
        found: type = getattr(import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"the type {ros_type} is not known here: {error}",
            remedy=f"Install {package}, or source the workspace that builds it.",
        ) from error
    return found


def plain(value: Any) -> Any:
    """Return a message, or what is in one, as numbers, text, lists and dicts."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, np.ndarray | np.generic | array):
        return value.tolist()
    if isinstance(value, bytes):
        return int.from_bytes(value, "little") if len(value) == 1 else list(value)
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value


def fill_plain(message: Any, fields: Mapping[str, Any], where: str = "") -> None:
    """Set fields of a message, those of inner messages by a mapping.

    Raises:
        ConfigError: there is no such field, or the value is not of its type.
    """
    types: Mapping[str, str] = message.get_fields_and_field_types()
    for name, value in fields.items():
        path = f"{where}{name}"
        if name not in types:
            raise ConfigError(
                "there is no such field",
                where=path,
                remedy=f"There are: {', '.join(types) or 'none at all'}.",
            )
        if "/" in types[name] and isinstance(value, Mapping):
            fill_plain(getattr(message, name), value, f"{path}.")
            continue
        try:
            setattr(message, name, _typed(types[name], value))
        except (TypeError, ValueError, KeyError, OverflowError, AssertionError) as error:
            raise ConfigError(f"{value!r} is no {types[name]}", where=path) from error


def _typed(ros_type: str, value: Any) -> Any:
    """Return `value` as a field of `ros_type` takes it; ROS sends an int in a float as another number."""
    if ros_type.endswith("]") or ros_type.startswith("sequence"):
        if not isinstance(value, list):
            raise TypeError
        inner = ros_type.removeprefix("sequence<").partition(",")[0].rstrip(">").partition("[")[0]
        return [_typed(inner, each) for each in value]
    if ros_type == "boolean" and not isinstance(value, bool):
        raise TypeError
    if ros_type == "string" and not isinstance(value, str):
        raise TypeError
    return _CASTS[ros_type.rstrip("0123456789")](value)


_CASTS: Mapping[str, Callable[[Any], Any]] = MappingProxyType(
    {"boolean": bool, "string": str, "double": float, "float": float, "int": int, "uint": int}
)
