"""What is told of a plugin before it is imported: a file beside what its entry point names.

The package of an entry point may hold a file ``crtk_plugins.json``, by group and name of its entry points:

    {"crtk_drivers.devices": {"ur": {"summary": "UR arms", "sim": "ur", "commands": "measured_js hold"}}}

``python -m crtk_drivers.cli.description_files ur`` writes it, as the plugin is. Of a plugin without one, and
of one whose file cannot be read, what the plugin itself says is told: it is imported for that.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

FILE: Final = "crtk_plugins.json"


@dataclass(frozen=True)
class Description:
    """What a list tells of a plugin.

    Attributes:
        summary: one line for people.
        extra: the extra of its distribution that brings its libraries; empty if it needs none.
        sim: name of the simulator of a device; empty if it has none.
        commands: the CRTK names that a device offers, with spaces between them.
    """

    summary: str
    extra: str = ""
    sim: str = ""
    commands: str = ""


def description_of(entry_point: EntryPoint) -> Description | None:
    """Return what is written beside an entry point; None if nothing is, or nothing that can be read."""
    for folder in package_folders(entry_point):
        found = _read(folder / FILE).get(entry_point.group, {}).get(entry_point.name)
        if found is not None:
            return _made_of(found)
    return None


def _made_of(found: Any) -> Description | None:
    names = {field.name for field in fields(Description)}
    is_sound = isinstance(found, dict) and "summary" in found and found.keys() <= names
    if not is_sound or not all(isinstance(value, str) for value in found.values()):
        return None
    return Description(**found)


def package_folders(entry_point: EntryPoint) -> tuple[Path, ...]:
    """Return where the package of an entry point is, without an import; a namespace is in several places."""
    try:
        spec = find_spec(entry_point.value.partition(":")[0].partition(".")[0])
    except (ImportError, ValueError):
        return ()
    return tuple(map(Path, spec.submodule_search_locations or ())) if spec else ()


@cache
def _read(path: Path) -> Mapping[str, Mapping[str, Any]]:
    try:
        content: Any = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    well_formed = isinstance(content, dict) and all(isinstance(x, dict) for x in content.values())
    return content if well_formed else {}
