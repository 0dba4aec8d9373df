"""The environment of a lab's units: as the shell has it that writes them, and open to nobody by accident.

systemd starts a unit in an almost empty environment. Therefore the unit says where an installed ROS 2 is, and
what decides whom a device meets.
"""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from crtk_drivers.config.variables import (
    CYCLONE,
    DOMAIN,
    FILES,
    LOCALHOST_ONLY,
    PROFILES,
    RANGE,
    RANGES,
    SEARCH_PATHS,
    SERVER,
    STATIC_PEERS,
    as_said,
    assignments,
    before,
    carried,
    dropped,
    elevated_by,
)
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.lab_file import Lab

__all__ = ["closed_to_others", "doubts", "not_working", "origin", "unit_environment"]

TRIAL_TIMEOUT: Final = 60.0
"""Seconds in which Python, ROS 2 and a node have started."""

SYSTEMD_PATH: Final = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin"
"""`PATH` of a service, if nothing is said."""

_DEFAULTS: Final = {DOMAIN: "0", RANGE: "LOCALHOST"}
_OPENING: Final = (RANGE, STATIC_PEERS)
_OF_THIS_MACHINE: Final = ("LOCALHOST", "OFF")
_JUDGED_BY_NOBODY: Final = (*PROFILES, CYCLONE, SERVER)


def unit_environment(lab: Lab) -> dict[str, str]:
    """Return the variables of every unit of a lab.

    They are those of this process that a device needs, under those of the lab. ROS 2 stays on this machine
    unless the lab file says otherwise.

    Raises:
        ConfigError: `sudo` has dropped some, or the network is let in without a word in the lab file.
    """
    shell = as_said(os.environ)
    _refuse_opened(lab, shell)
    found = _DEFAULTS | carried(shell) | dict(lab.environment)
    if RANGE not in lab.settings.environment and found[RANGE] not in _OF_THIS_MACHINE:
        found[RANGE] = _DEFAULTS[RANGE]
    _refuse_dropped(lab, shell, found)
    places = {name: _absolute(name, _not_of_wheels(name, found[name])) for name in sorted(found)}
    return {name: value for name, value in places.items() if value}


def origin(lab: Lab, name: str) -> str:
    """Return where a variable of the units was said, in words."""
    if name in lab.environment:
        is_of_file = lab.settings.environment.get(name) == lab.environment[name]
        return "of the lab file" if is_of_file else "of --env"
    return "of this shell" if name in carried(as_said(os.environ)) else "nothing was said"


def doubts(variables: Mapping[str, str]) -> Iterator[str]:
    """Yield what a person should look at: files that are not there, and what else decides who gets in."""
    for name, path in _paths(variables):
        if not path.exists():
            yield f"{name}: there is no {path}"
    for name in _JUDGED_BY_NOBODY:
        if variables.get(name):
            yield f"{name} decides beside {RANGE} who can reach the devices: look at it yourself"


def closed_to_others(lab: Lab, variables: Mapping[str, str]) -> dict[Path, Path]:
    """Return the folders and files that are closed to the users of units, each with what lies there."""
    wanted = [Path(sys.prefix), Path(sys.base_prefix), lab.path.parent.resolve()]
    wanted += [path for _, path in _paths(variables) if path.exists()]
    for name in SEARCH_PATHS:
        wanted += [Path(each) for each in variables.get(name, "").split(":") if Path(each).exists()]
    found: dict[Path, Path] = {}
    for path in wanted:
        for each in reversed((path, *path.parents)):
            mode = each.stat().st_mode
            needed = stat.S_IXOTH if stat.S_ISDIR(mode) else stat.S_IROTH
            if not mode & needed:
                found.setdefault(each, path)
                break
    return found


def not_working(lab: Lab, variables: Mapping[str, str]) -> str:
    """Start a node as a unit would, in an environment that is empty otherwise; return why that fails.

    Empty if it works. The node has no device, and ends at once.
    """
    order = {
        "plugins": sorted({device.plugin.name for device in lab.devices.values()}),
        "enclaves": sorted({device.enclave for device in lab.devices.values()}),
    }
    with tempfile.TemporaryDirectory(prefix="crtk-trial-") as home:
        own = {"PATH": SYSTEMD_PATH, "HOME": home, "ROS_LOG_DIR": home}
        try:
            done = subprocess.run(
                (sys.executable, "-m", "crtk_drivers.ros.node_trial", json.dumps(order)),
                env=own | dict(variables),
                cwd=lab.path.parent,
                capture_output=True,
                text=True,
                timeout=TRIAL_TIMEOUT,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return str(error)
    if done.returncode == 0:
        return ""
    return (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]


def _refuse_dropped(lab: Lab, shell: Mapping[str, str], found: Mapping[str, str]) -> None:
    by = elevated_by(shell)
    if not by:
        return
    lost = {
        name: value
        for name, value in dropped(shell).items()
        if name not in lab.environment and found.get(name) != value
    }
    ways = (
        "Write the units as yourself, into a folder of yours with --for, and copy them as root; or say it in "
        f"the lab file, environment = {{ {DOMAIN} = 42 }}, or by --env {DOMAIN}=42."
    )
    if lost:
        raise ConfigError(
            f"{by} has dropped what the devices shall run with: {assignments(lost)}",
            where=str(lab.path),
            remedy=ways,
        )
    if before(by) is None and DOMAIN not in {**shell, **lab.environment}:
        raise ConfigError(
            f"{by} drops the variables of ROS 2, and nobody says in which domain the devices shall run "
            f"({DOMAIN})",
            where=str(lab.path),
            remedy=ways,
        )


def _refuse_opened(lab: Lab, shell: Mapping[str, str]) -> None:
    of_file = lab.settings.environment
    said = {**shell, **lab.environment}
    opened = {
        name: said[name]
        for name in _OPENING
        if said.get(name) and name not in of_file and said[name] not in _OF_THIS_MACHINE
    }
    if opened.get(RANGE, RANGES[0]) not in RANGES or said.get(LOCALHOST_ONLY) == "1":
        opened.pop(RANGE, None)  # ROS 2 takes it for LOCALHOST
    if opened:
        table = ", ".join(f'{name} = "{value}"' for name, value in opened.items())
        raise ConfigError(
            f"{assignments(opened)} would let other machines command the devices, and the lab file does not "
            "say so",
            where=str(lab.path),
            remedy=f"Write environment = {{ {table} }} into it, or `unset {' '.join(opened)}`.",
        )


def _paths(variables: Mapping[str, str]) -> Iterator[tuple[str, Path]]:
    for name in FILES:
        if variables.get(name):
            yield name, Path(variables[name])
    for each in _uris(variables.get(CYCLONE, "")):
        if each and not each.startswith("<"):
            yield CYCLONE, Path(each.removeprefix("file://"))


def _uris(value: str) -> list[str]:
    """Return the parts of `CYCLONEDDS_URI`: files, or one piece of XML that may have commas."""
    return [value] if "<" in value else value.split(",")


def _not_of_wheels(name: str, value: str) -> str:
    """Return a search path without what the ROS wheels add by themselves as Python starts."""
    if name not in SEARCH_PATHS:
        return value
    own = Path(sys.prefix).resolve()

    def is_added(path: Path) -> bool:
        return path == own / "lib" or (path.suffix == ".libs" and path.is_relative_to(own))

    return ":".join(each for each in value.split(":") if not is_added(Path(each).resolve()))


def _absolute(name: str, value: str) -> str:
    """Return a value whose relative paths count from here: a unit runs elsewhere."""
    if name in SEARCH_PATHS:
        return ":".join(os.path.abspath(each) for each in value.split(":") if each)
    if name in FILES:
        return os.path.abspath(value)
    if name == CYCLONE:
        has_scheme = [each.startswith(("<", "file:")) or "<" in each for each in _uris(value)]
        return ",".join(
            each if is_whole else os.path.abspath(each)
            for each, is_whole in zip(_uris(value), has_scheme, strict=True)
        )
    return value
