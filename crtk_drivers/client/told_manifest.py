"""What of a manifest can be used: anybody may publish one, and with anything in it.

Values whose type is not that of `crtk_drivers.ros.manifest` are left out: who reads a manifest need not check
them. Control characters are left out, too: with them, a name could write anything on a terminal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

from crtk_drivers.errors.wording import printable

_ROW: Final = ("name", "type")
_WORDS: Final = ("name", "unit")


def usable(content: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return what of a manifest has the right type, and the keys where something has not."""
    cleaned: dict[str, Any] = {key: _printable(value) for key, value in content.items()}
    kept = {key: _KEPT[key](value) if key in _KEPT else value for key, value in cleaned.items()}
    wrong = [key for key, value in kept.items() if value != cleaned[key]]
    return {key: value for key, value in kept.items() if value is not _WRONG}, wrong


_WRONG: Final = object()


def _printable(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value, keeping="")
    if isinstance(value, list):
        return [_printable(each) for each in value]
    if isinstance(value, dict):
        return {_printable(key): _printable(each) for key, each in value.items()}
    return value


def _rows(value: Any) -> Any:
    if not isinstance(value, dict):
        return _WRONG
    return {
        name: row
        for name, row in value.items()
        if isinstance(row, dict) and all(isinstance(row.get(key), str) for key in _ROW)
    }


def _names(value: Any) -> Any:
    if not isinstance(value, list):
        return _WRONG
    return [each for each in value if isinstance(each, str)]


def _object(value: Any) -> Any:
    return value if value is None or isinstance(value, dict) else _WRONG


def _texts(value: Any) -> Any:
    if not isinstance(value, dict):
        return _WRONG
    return {key: text for key, text in value.items() if isinstance(text, str)}


def _joints(value: Any) -> Any:
    """Return the joints; all or none, as their order is that of all vectors."""
    if not isinstance(value, list):
        return _WRONG
    if not all(isinstance(each, dict) and isinstance(each.get("name"), str) for each in value):
        return _WRONG
    return [
        {
            key: each
            for key, each in joint.items()
            if (isinstance(each, str) if key in _WORDS else _is_limit(each))
        }
        for joint in value
    ]


def _is_limit(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


_KEPT: Final[Mapping[str, Callable[[Any], Any]]] = MappingProxyType(
    {
        "commands": _rows,
        "services": _rows,
        "inputs": _rows,
        "readings": _rows,
        "children": _names,
        "followers": _names,
        "estimates": _names,
        "device": _texts,
        "joints": _joints,
        "tool": _object,
        "frames": _object,
        "rates": _object,
        "stop": _object,
        "following": _object,
        "command_limits": _object,
    }
)
