"""Many names in few words: those of a level or with numbers are shown as one."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from itertools import groupby

from crtk_drivers.commands import Command, Level


def short_names(commands: Mapping[str, Command]) -> str:
    """Return the names in one line: ``measured_js/cp  servo_jp/jr  hold  body/: servo_cv/cf``."""
    own = {name: command for name, command in commands.items() if "/" not in name}
    parts = _short(own)
    spaces = dict.fromkeys(name.rpartition("/")[0] for name in commands if "/" in name)
    for space in spaces:
        inside = {
            name.removeprefix(f"{space}/"): command
            for name, command in commands.items()
            if name.startswith(f"{space}/")
        }
        parts.append(f"{space}/: {' '.join(_short(inside))}")
    return "  ".join(parts)


def _short(commands: Mapping[str, Command]) -> list[str]:
    """Return names, those of a level joined."""
    parts: list[str] = []
    for level, rows in groupby(commands.items(), key=lambda row: row[1].level):
        names = [name for name, _ in rows]
        plain = level in (Level.STATE, Level.QUERY, Level.SETTING)
        parts += names if plain else [_joined(level, names)]
    return parts


def _joined(level: Level, names: Iterable[str]) -> str:
    return f"{level}_{'/'.join(name.removeprefix(f'{level}_') for name in names)}"


def numbered(names: Iterable[str]) -> Mapping[str, str]:
    """Return what to show for names, and the first that it stands for: ``in_0…7`` is one, of ``in_0``."""
    families: dict[tuple[str, str], list[str]] = {}
    for name in names:
        found = re.fullmatch(r"(.*?_)(\d+)(_.*)?", name)
        family = (found[1], found[3] or "") if found else (name, "")
        families.setdefault(family, []).append(found[2] if found else "")
    shown = {}
    for (before, after), numbers in families.items():
        first = f"{before}{numbers[0]}{after}"
        last = f"…{numbers[-1]}" if len(numbers) > 1 else ""
        shown[f"{before}{numbers[0]}{last}{after}"] = first
    return shown
