"""Drives on the CAN buses of this machine, for a lab file. Needs the libraries of the extra."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from crtk_driver_canopen.config import BusConfig, CanopenConfig
from crtk_driver_canopen.scanning import Found, answering, survey
from crtk_driver_canopen.tools import opened_master
from crtk_drivers.plugins import Finder, FoundDevice

WAIT: Final = 0.3
"""Seconds for the last answer."""

_INTERFACES: Final = Path("/sys/class/net")
_ARPHRD_CAN: Final = "280"
_IFF_UP: Final = 1


def _places() -> list[str]:
    """Return the CAN interfaces of the kernel that are up."""
    return [
        path.name
        for path in sorted(_INTERFACES.glob("*"))
        if _text(path / "type") == _ARPHRD_CAN and int(_text(path / "flags") or "0", 16) & _IFF_UP
    ]


def _text(path: Path) -> str:
    try:
        return path.read_text("ascii").strip()
    except OSError:
        return ""


def _look(place: str) -> Iterable[FoundDevice]:
    """Ask every node id of a bus: ``can0``, or interface and channel of python-can, ``slcan:/dev/ttyACM0``.

    Raises:
        ConfigError, ConnectionFailed: the bus cannot be opened.
    """
    interface, separator, channel = place.partition(":")
    bus = {"interface": interface, "channel": channel} if separator else {"channel": place}
    with opened_master(CanopenConfig(bus=BusConfig.model_validate(bus))) as master:
        found = survey(master, answering(master.link, WAIT))
    if not found:
        return []
    joints: dict[str, dict[str, Any]] = {}
    for one in found:
        for axis in one.axes:
            of_several = {"axis": axis.number} if axis.number else {}
            joints[f"joint_{len(joints) + 1}"] = {"node": one.node, **of_several}
    return [FoundDevice({"bus": bus, "joints": joints}, ", ".join(map(_told, found)))]


def _told(found: Found) -> str:
    name = found.identity.name or f"profile {found.identity.profile}"
    return f"node {found.node}: {name}" + ("" if found.axes else ", no drive")


def _takes(place: str) -> bool:
    return not place.startswith("/") and "://" not in place


FINDER: Final = Finder(_places, _takes, _look)
