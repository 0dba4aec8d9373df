"""Environment variables that decide how a process talks ROS 2: what they may hold, and who drops them.

Sources: ROS 2 Jazzy, "Configuring environment", "Improved dynamic discovery" and the environment variables of
rcl, rmw_fastrtps, rmw_cyclonedds and sros2; sudo(8), doas(1), pkexec(1).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Final

DOMAIN: Final = "ROS_DOMAIN_ID"
LAST_DOMAIN: Final = 232
"""The ports of one above it would be above 65535."""
RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"
RANGES: Final = ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT")
STATIC_PEERS: Final = "ROS_STATIC_PEERS"
LOCALHOST_ONLY: Final = "ROS_LOCALHOST_ONLY"
RMW: Final = "RMW_IMPLEMENTATION"
PROFILES: Final = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""The names of Fast DDS 2 and 3 for one thing."""
TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
CYCLONE: Final = "CYCLONEDDS_URI"
SERVER: Final = "ROS_DISCOVERY_SERVER"
SECURED: Final = "ROS_SECURITY_ENABLE"
STRATEGY: Final = "ROS_SECURITY_STRATEGY"
KEYSTORE: Final = "ROS_SECURITY_KEYSTORE"
QOS_OF_XML: Final = "RMW_FASTRTPS_USE_QOS_FROM_XML"
ZENOH: Final = (
    "ZENOH_SESSION_CONFIG_URI",
    "ZENOH_ROUTER_CONFIG_URI",
    "ZENOH_CONFIG_OVERRIDE",
)

LOOPBACK: Final = Path(__file__).parents[1] / "ros" / "loopback.xml"
"""What `crtk_drivers.ros.environment.share_no_memory` gives Fast DDS for the range LOCALHOST."""

DECIDING: Final = (
    *(DOMAIN, RANGE, STATIC_PEERS, LOCALHOST_ONLY, RMW, *PROFILES, TRANSPORTS, CYCLONE),
    *(SERVER, "ROS_SUPER_CLIENT", QOS_OF_XML, *ZENOH),
    *(SECURED, STRATEGY, KEYSTORE, "ROS_SECURITY_ENCLAVE_OVERRIDE"),
)
"""Who meets whom, from where, and by what security. Two that shall meet have the same."""

SEARCH_PATHS: Final = ("PYTHONPATH", "AMENT_PREFIX_PATH", "LD_LIBRARY_PATH")
"""Where an installed ROS 2 is, as its setup script says."""

FILES: Final = (*PROFILES, KEYSTORE, *ZENOH[:2])
"""Variables that hold the path of a file or folder."""

_WORDS: Final[Mapping[str, tuple[str, ...]]] = {
    RANGE: RANGES,
    LOCALHOST_ONLY: ("", "0", "1"),
    QOS_OF_XML: ("", "0", "1"),
    SECURED: ("", "false", "true"),
    STRATEGY: ("", "Permissive", "Enforce"),
}
"""All that ROS 2 understands. It takes anything else for "no", without a word."""

_YES_AND_NO: Final[Mapping[str, tuple[str, str]]] = {
    LOCALHOST_ONLY: ("1", "0"),
    QOS_OF_XML: ("1", "0"),
    RANGE: ("true", "OFF"),
}
"""How true and false are written where not by these words. YAML takes OFF for false."""

_UNSAID: Final[Mapping[str, tuple[str, ...]]] = {
    DOMAIN: ("0",),
    RANGE: ("SUBNET", "SYSTEM_DEFAULT"),
    LOCALHOST_ONLY: ("0",),
    QOS_OF_XML: ("0",),
    RMW: ("rmw_fastrtps_cpp",),
    TRANSPORTS: ("UDPv4",),
    SECURED: ("false",),
    STRATEGY: ("Permissive",),
}
"""Values that change nothing for a driver or a client: it does the same where nothing is said."""

_PREFIXES: Final = (
    "ROS_",
    "RMW_",
    "RCUTILS_",
    "RCL_",
    "FASTDDS_",
    "FASTRTPS_",
    "CYCLONEDDS_",
    "ZENOH_",
)
_VENDORS: Final = ("CRTK_DRIVERS_ONLY", "FDSDK", "GTDD_HOME", "NDDSHOME", "RTI_LICENSE_FILE")
_OWN_TO_A_PROCESS: Final = frozenset(
    {"ROS_LOG_DIR", "ROS_HOME", "ROS_NAMESPACE", "ROS_PACKAGE_PATH"}
)

_ELEVATING: Final = {
    "SUDO_COMMAND": "sudo",
    "SUDO_USER": "sudo",
    "DOAS_USER": "doas",
    "PKEXEC_UID": "pkexec",
}
"""Variables by which a program that starts others as root is known, and its name."""

_LIKE: Final = 0.85
"""Likeness from which a name is taken for a misspelt one of `DECIDING`."""


def is_carried(name: str) -> bool:
    """Whether a process needs a variable to work as the shell does that started it."""
    if name in _OWN_TO_A_PROCESS:
        return False
    return name in SEARCH_PATHS or name in _VENDORS or name.startswith(_PREFIXES)


def as_said(variables: Mapping[str, str]) -> dict[str, str]:
    """Return variables as a user says them: LOCALHOST, and not what `share_no_memory` has made of it."""
    found = dict(variables)
    if found.get(PROFILES[0]) == str(LOOPBACK):
        for name in PROFILES:
            found.pop(name, None)
        found[RANGE] = "LOCALHOST"
    return found


def merged(variables: Mapping[str, str], over: Mapping[str, str]) -> dict[str, str]:
    """Return variables with others over them. Another range replaces all that the first one has led to."""
    return (as_said(variables) if RANGE in over else dict(variables)) | dict(over)


def carried(variables: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that a process needs to work as the shell does that has these."""
    return {name: value for name, value in variables.items() if value and is_carried(name)}


def checked_variables(given: Mapping[str, str | int | bool]) -> dict[str, str]:
    """Return variables that were written by hand, as text.

    Raises:
        ValueError: one has no name that a variable can have, or a value that cannot be right.
    """
    found = {name: _text(name, value) for name, value in given.items()}
    for name, value in found.items():
        if not (name.isascii() and name.isidentifier()):
            raise ValueError(f"{name!r} is no name of a variable")
        if any(each in value for each in "\0\n"):
            raise ValueError(f"{name}: has more than one line, or a NUL character")
        meant = [each for each in get_close_matches(name, DECIDING, 1, _LIKE) if each not in name]
        if name not in DECIDING and meant:
            raise ValueError(f"{name} is no variable of ROS 2. Did you mean {meant[0]!r}?")
        if name in _WORDS and value not in _WORDS[name]:
            known = ", ".join(filter(None, _WORDS[name]))
            raise ValueError(f"{name}: {value!r} is none of {known}")
    if not is_domain(found.get(DOMAIN, "")):
        raise ValueError(f"{DOMAIN}: {found[DOMAIN]!r} is not a ROS domain: 0 to {LAST_DOMAIN}")
    return found


def absolute(variables: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Return variables whose relative paths count from a folder, for a process that runs in another one."""
    return {name: _absolute(name, value, folder) for name, value in variables.items()}


def uris(value: str) -> list[str]:
    """Return the parts of `CYCLONEDDS_URI`: files, or one piece of XML that may have commas."""
    return [value] if "<" in value else value.split(",")


def is_domain(text: str) -> bool:
    """Whether a text is the number of a ROS domain, or empty."""
    return not text or (text.isascii() and text.isdigit() and int(text) <= LAST_DOMAIN)


def elevated_by(variables: Mapping[str, str]) -> str:
    """Return the program that started this one as another user, such as ``sudo``; empty if none did."""
    return next((by for name, by in _ELEVATING.items() if variables.get(name)), "")


def before(program: str) -> dict[str, str] | None:
    """Return the environment that `program`, from which this process descends, was started in.

    None where that cannot be known: the program has ended, or its environment may not be read.
    """
    pid = os.getppid()
    try:
        while pid > 1:
            folder = Path(f"/proc/{pid}")
            if (folder / "comm").read_text().strip() == program:
                return _environment_of(folder)
            pid = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
    except (OSError, ValueError, IndexError):
        pass
    return None


def dropped(variables: Mapping[str, str]) -> dict[str, str]:
    """Return what `sudo`, or one like it, has dropped of the environment that this process shall have.

    A variable that is set here, though empty, was not dropped.
    """
    by = elevated_by(variables)
    was = as_said(before(by) or {}) if by else {}
    return {name: value for name, value in carried(was).items() if name not in variables}


def is_unsaid(name: str, value: str) -> bool:
    """Whether a value of a variable changes nothing for a driver or a client."""
    return value in _UNSAID.get(name, ())


def assignments(variables: Mapping[str, str]) -> str:
    """Return variables as they are written before a command."""
    return " ".join(f"{name}={value}" for name, value in variables.items())


def _text(name: str, value: str | int | bool) -> str:
    if isinstance(value, bool):
        yes, no = _YES_AND_NO.get(name, ("true", "false"))
        return yes if value else no
    return str(value)


def _absolute(name: str, value: str, folder: Path) -> str:
    def from_there(path: str) -> str:
        return os.path.normpath(folder.absolute() / path)

    if name in SEARCH_PATHS:
        return ":".join(from_there(each) for each in value.split(":") if each)
    if name in FILES:
        return from_there(value) if value else ""
    if name == CYCLONE:
        return ",".join(
            from_there(each) if each and not ("<" in each or each.startswith("file:")) else each
            for each in uris(value)
        )
    return value


def _environment_of(folder: Path) -> dict[str, str]:
    words = (folder / "environ").read_bytes().decode(errors="surrogateescape").split("\0")
    return {name: value for name, mark, value in (word.partition("=") for word in words) if mark}
