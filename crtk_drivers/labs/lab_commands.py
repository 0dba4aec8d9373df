"""Whether the commands of a lab file can be run: known before any of its devices is powered."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from crtk_drivers.config import from_file
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.lab_file import Lab

__all__ = ["require_commands"]

_HEAD: Final = 256
"""Bytes of a first line that the kernel reads."""


def require_commands(lab: Lab, *, programs: bool = True) -> None:
    """Look for the program of each command in a lab file; run none of them.

    The `power_off` of a simulated device is never run, and may be missing.

    Args:
        lab: with the commands.
        programs: look at those of ``[programs]`` too.

    Raises:
        ConfigError: the system could not start one of them, with the line.
    """
    commands = {
        ("devices", name, "power_off"): device.entry.power_off
        for name, device in lab.devices.items()
        if not device.sim
    }
    if programs:
        commands |= {
            ("programs", name, "command"): program.command for name, program in lab.programs.items()
        }
    search = os.get_exec_path({**os.environ, **lab.environment})
    for key, command in commands.items():
        why = _missing(command[0], lab.path.parent, search) if command else ""
        if why:
            raise ConfigError(
                f"cannot be run: {why}",
                where=from_file(lab.path).place(key),
                remedy="Install the program, or correct the command. It is started in the folder of the "
                "lab file, without a shell.",
            )


def _missing(program: str, folder: Path, search: Sequence[str]) -> str:
    """Return why the system cannot start a program in a folder; empty if it can."""
    folders = [""] if "/" in program else search
    paths = [folder / each / program for each in folders]
    there = [path for path in paths if path.is_file()]
    found = next((path for path in there if os.access(path, os.X_OK)), None)
    if found is not None:
        return _unreadable(found, folder, search)
    if there:
        return f"{there[0]} is not executable"
    where = "" if "/" in program else " in PATH"
    return f"there is no program {program!r}{where}"


def _unreadable(path: Path, folder: Path, search: Sequence[str]) -> str:
    """Return why the kernel cannot execute a file; empty if it can, or it may not be read."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return ""
    if not head.startswith(b"#!"):
        return "" if b"\0" in head else f"{path} is a script without #! in its first line"
    words = head[2:].partition(b"\n")[0].decode(errors="replace").split()
    if not words:
        return f"{path} names no program after #!"
    needed = words[:1]
    if Path(words[0]).name == "env":  # which looks for another one in PATH
        needed += [word for word in words[1:] if not (word.startswith("-") or "=" in word)][:1]
    for interpreter in needed:
        if why := _missing(interpreter, folder, search):
            return f"{path} needs another program: {why}"
    return ""
