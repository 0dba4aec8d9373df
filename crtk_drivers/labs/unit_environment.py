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
    KEYSTORE,
    LOCALHOST_ONLY,
    PROFILES,
    RANGE,
    RANGES,
    SEARCH_PATHS,
    SERVER,
    STATIC_PEERS,
    ZENOH,
    absolute,
    as_said,
    assignments,
    before,
    carried,
    dropped,
    elevated_by,
    uris,
)
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.lab_file import Lab

__all__ = [
    "JUDGED_BY_NOBODY",
    "closed_to_others",
    "doubts",
    "hidden",
    "not_working",
    "origin",
    "unit_environment",
]

TRIAL_TIMEOUT: Final = 60.0
"""Seconds in which Python, ROS 2 and a node have started."""

SYSTEMD_PATH: Final = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin"
"""`PATH` of a service, if nothing is said."""

_DEFAULTS: Final = {DOMAIN: "0", RANGE: "LOCALHOST"}
_OPENING: Final = (RANGE, STATIC_PEERS)
_OF_THIS_MACHINE: Final = ("LOCALHOST", "OFF")
JUDGED_BY_NOBODY: Final = (*PROFILES, CYCLONE, SERVER, *ZENOH)
"""Variables that decide on their own who is met; what they name is not read."""

_PRIVATE: Final = (Path("/tmp"), Path("/var/tmp"))
"""A unit has folders of its own in place of these (PrivateTmp=)."""


def unit_environment(lab: Lab) -> dict[str, str]:
    """Return the variables of every unit of a lab.

    They are those of this process that a device needs, under those of the lab. ROS 2 stays on this machine
    unless the lab file says otherwise.

    Raises:
        ConfigError: `sudo` has dropped some, one is no text, or the network is let in without a word in the
            lab file.
    """
    shell = as_said(os.environ)
    _refuse_opened(lab, shell)
    found = _DEFAULTS | carried(shell) | dict(lab.environment)
    if RANGE not in lab.settings.environment and found[RANGE] not in _OF_THIS_MACHINE:
        found[RANGE] = _DEFAULTS[RANGE]
    _refuse_dropped(lab, shell, found)
    places = absolute({name: _not_of_wheels(name, found[name]) for name in sorted(found)}, Path())
    for name, value in places.items():
        if not value.isascii() and value != value.encode(errors="replace").decode():
            raise ConfigError(
                f"{value!r} is not UTF-8, and systemd takes no other text",
                where=name,
                remedy=f"Rename what it names, or `unset {name}`.",
            )
    return {name: value for name, value in places.items() if value}


def origin(lab: Lab, name: str) -> str:
    """Return where a variable of the units was said, in words."""
    if name in lab.environment:
        said = {each: str(value) for each, value in lab.settings.environment.items()}
        is_of_file = absolute(said, lab.path.parent).get(name) == lab.environment[name]
        return "of the lab file" if is_of_file else "of --env"
    return "of this shell" if name in carried(as_said(os.environ)) else "nothing was said"


def doubts(variables: Mapping[str, str]) -> Iterator[str]:
    """Yield what a person should look at: files that are not there, and what else decides who gets in."""
    for name, path in _paths(variables):
        if not path.exists():
            yield f"{name}: there is no {path}"
    for name in JUDGED_BY_NOBODY:
        if variables.get(name):
            yield f"{name} decides beside {RANGE} who can reach the devices: look at it yourself"
    if variables.get(LOCALHOST_ONLY) == "1" and variables.get(RANGE) not in _OF_THIS_MACHINE:
        yield (
            f"{LOCALHOST_ONLY}=1 goes over {RANGE}={variables[RANGE]}: no other machine reaches the devices"
        )


def closed_to_others(lab: Lab, variables: Mapping[str, str]) -> dict[Path, Path]:
    """Return the folders and files that are closed to the users of units, each with what lies there."""
    found: dict[Path, Path] = {}
    for given in _needed(lab, variables):
        for path in dict.fromkeys((given, given.resolve())):
            for each in reversed((path, *path.parents)):
                mode = each.stat().st_mode
                needed = stat.S_IXOTH if stat.S_ISDIR(mode) else stat.S_IROTH
                if not mode & needed:
                    found.setdefault(each, given)
                    break
    return found


def hidden(lab: Lab, variables: Mapping[str, str]) -> list[Path]:
    """Return the folders and files that a unit does not see: it has a /tmp of its own."""
    return [
        path
        for path in dict.fromkeys(_needed(lab, variables))
        if any(path.resolve().is_relative_to(each) for each in _PRIVATE)
    ]


def _needed(lab: Lab, variables: Mapping[str, str]) -> Iterator[Path]:
    """Yield the folders and files that a unit reads, those that are there."""
    yield from (Path(sys.prefix), Path(sys.base_prefix), lab.path.parent.resolve())
    yield from (path for _, path in _paths(variables) if path.exists())
    for name in SEARCH_PATHS:
        for each in filter(None, variables.get(name, "").split(":")):
            if Path(each).exists():
                yield Path(each)
    if keys := variables.get(KEYSTORE):
        for device in lab.devices.values():
            if device.enclave:
                yield from sorted(Path(keys, "enclaves", device.enclave.strip("/")).glob("*"))


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
        if said.get(name) not in (None, "", *_OF_THIS_MACHINE) and said[name] != of_file.get(name)
    }
    if opened.get(RANGE, RANGES[0]) not in RANGES or said.get(LOCALHOST_ONLY) == "1":
        opened.pop(RANGE, None)  # ROS 2 takes it for LOCALHOST
    if opened:
        table = ", ".join(f'{name} = "{value}"' for name, value in opened.items())
        raise ConfigError(
            f"{assignments(opened)} would let other machines command the devices, and the lab file does not "
            "say so",
            where=str(lab.path),
            remedy=f"Write environment = {{ {table} }} into it; or leave it out of --env, and "
            f"`unset {' '.join(opened)}`.",
        )


def _paths(variables: Mapping[str, str]) -> Iterator[tuple[str, Path]]:
    for name in FILES:
        if variables.get(name):
            yield name, Path(variables[name])
    for each in uris(variables.get(CYCLONE, "")):
        if each and not each.startswith("<"):
            yield CYCLONE, Path(each.removeprefix("file://"))


def _not_of_wheels(name: str, value: str) -> str:
    """Return a search path without what the ROS wheels add by themselves as Python starts."""
    if name not in SEARCH_PATHS:
        return value
    own = Path(sys.prefix).resolve()

    def is_added(path: Path) -> bool:
        return path == own / "lib" or (path.suffix == ".libs" and path.is_relative_to(own))

    return ":".join(each for each in value.split(":") if not is_added(Path(each).resolve()))
