"""Definitions of ROS types as MCAP has them (its encoding ros2msg), found where ROS packages are installed.

Comments are left out. No rclpy here. Source: ROS 2 documentation, "About ROS 2 interfaces", 2.1 Messages.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

RULE: Final = "=" * 80 + "\n"

_PRIMITIVE: Final = re.compile(r"(bool|byte|char|float32|float64|u?int(8|16|32|64)|w?string)\b")
_ARRAY: Final = re.compile(r"\[.*|<=.*")


@cache
def definition_of(ros_type: str) -> str:
    """Return a type's definition with those of the types in it; empty if a file of it is not installed."""
    texts: dict[str, str] = {}
    try:
        _collect(ros_type, texts)
    except (OSError, ValueError):
        return ""
    (_, own), *others = texts.items()
    return (own or "\n") + "".join(f"{RULE}MSG: {name}\n{text}" for name, text in others)


def _collect(ros_type: str, texts: dict[str, str]) -> None:
    package, _, name = ros_type.replace("/msg/", "/").partition("/")
    short = f"{package}/{name}"
    if short in texts:
        return
    lines = (line.partition("#")[0].split() for line in _text_of(package, name).splitlines())
    fields = [words for words in lines if words]
    texts[short] = "".join(f"{' '.join(words)}\n" for words in fields)
    for kind, *_ in fields:
        inner = _ARRAY.sub("", kind)
        if not _PRIMITIVE.match(inner):
            _collect(inner if "/" in inner else f"{package}/{inner}", texts)


def _text_of(package: str, name: str) -> str:
    for prefix in _prefixes():
        path = prefix / "share" / package / "msg" / f"{name}.msg"
        if path.is_file():
            return path.read_text("utf-8")
    raise FileNotFoundError(f"{package}/{name}")


def _prefixes() -> Iterator[Path]:
    """Yield where packages may be: in sourced workspaces, and in this environment."""
    yield from map(Path, filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)))
    yield Path(sys.prefix)
