"""What a lab file says while no driver is looked at: names, namespaces, machines, environment.

That is enough for clients, on whatever machine they are and whichever drivers are installed there.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crtk_drivers.config import Layer, from_file, load
from crtk_drivers.config.variables import absolute, checked_variables
from crtk_drivers.errors import ConfigError
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.labs.lab_entries import (
    NAME,
    NAMESPACE,
    DeviceEntry,
    LabSettings,
    TeleopLabSettings,
)
from crtk_drivers.labs.machines import Shares, shares_of
from crtk_drivers.motion.teleop.teleop_settings import TeleopSettings

__all__ = [
    "LabOutline",
    "LabTeleop",
    "check_places",
    "load_outline",
    "load_teleop",
    "namespace_of",
    "require_device",
]


@dataclass(frozen=True)
class LabOutline:
    """A lab file whose drivers were not looked at.

    Attributes:
        path: of the file.
        settings: as they were written.
        layer: the same with its lines, for messages.
        shares: which machine starts what.
        environment: variables for every process of the lab, over those of the shell.
    """

    path: Path
    settings: LabSettings
    layer: Layer
    shares: Shares
    environment: Mapping[str, str]

    @property
    def bound_places(self) -> dict[str, str]:
        """Where each of its bounds was written, for messages."""
        return {name: self.layer.place(("bounds", name)) for name in self.settings.bounds}

    def entries(self, only: tuple[str, ...] = ()) -> dict[str, DeviceEntry]:
        """Return the devices by name.

        Args:
            only: those that are wanted; empty: all.

        Raises:
            ConfigError: one is not there.
        """
        for name in only:
            require_device(name, self.settings, str(self.path))
        return {
            name: entry for name, entry in self.settings.devices.items() if not only or name in only
        }

    def namespaces(self, only: tuple[str, ...] = ()) -> dict[str, str]:
        """Return where the devices are on ROS, by name.

        Args:
            only: see `entries`.

        Raises:
            ConfigError: one is not there, or two are in one namespace.
        """
        found = {name: namespace_of(name, entry) for name, entry in self.entries(only).items()}
        check_places(
            "namespace", ((space, name, space) for name, space in found.items()), self.layer
        )
        return found


def load_outline(path: str | Path) -> LabOutline:
    """Read a lab file, of whichever machines its devices are; no driver needs to be installed.

    Raises:
        ConfigError: with what is wrong, and the line.
    """
    path = Path(path)
    layer = from_file(path)
    settings = load(LabSettings, layer)
    _check_names(settings, layer)
    shares = shares_of(settings, layer)
    if settings.teleop is not None:
        for side in ("leader", "follower"):
            name = getattr(settings.teleop, side)
            _namespace_named(name, settings, layer.place(("teleop", side)))
    return LabOutline(path, settings, layer, shares, _said(settings, path))


@dataclass(frozen=True)
class LabTeleop:
    """The teleoperation of a lab file, the namespaces of the two, and the environment of the lab."""

    settings: TeleopSettings
    leader: str
    follower: str
    environment: Mapping[str, str] = field(default_factory=dict)


def load_teleop(path: str | Path) -> LabTeleop:
    """Read the table ``[teleop]`` of a lab file. The settings of its devices are not looked at.

    Raises:
        ConfigError: with what is wrong, and the line.
    """
    layer = from_file(path)
    settings = load(TeleopLabSettings, layer)
    leader, follower = (
        _namespace_named(getattr(settings.teleop, side), settings, layer.place(("teleop", side)))
        for side in ("leader", "follower")
    )
    if leader == follower:
        raise ConfigError(
            f"leader and follower are both {leader}",
            where=layer.place(("teleop", "follower")),
            remedy="A device cannot follow itself.",
        )
    return LabTeleop(settings.teleop, leader, follower, _said(settings, Path(path)))


def _said(settings: LabSettings, path: Path) -> dict[str, str]:
    """Return the environment of a lab file, whose relative paths count from the folder of the file."""
    return absolute(checked_variables(settings.environment), path.parent)


def _namespace_named(name: str, settings: LabSettings, place: str) -> str:
    """Return the namespace of a device of the lab, or of any device, that is named by its namespace."""
    if re.fullmatch(NAMESPACE, name):
        return name
    if name not in settings.devices:
        meant = near_names(name, settings.devices)
        raise ConfigError(
            f"there is no device {name!r}",
            where=place,
            remedy=f"Did you mean {meant[0]!r}?"
            if meant
            else f"Give one of this file ({', '.join(settings.devices) or 'it has none'}), or the "
            "namespace of any: /MTMR.",
        )
    return namespace_of(name, settings.devices[name])


def namespace_of(name: str, entry: DeviceEntry) -> str:
    """Return where a device of a lab is on ROS."""
    return entry.namespace or f"/{name}"


def _check_names(settings: LabSettings, lab: Layer) -> None:
    for kind, names in (("devices", settings.devices), ("programs", settings.programs)):
        for name in names:
            if not re.fullmatch(NAME, name):
                raise ConfigError(
                    f"{name!r} is no name",
                    where=lab.place((kind, name)),
                    remedy="Use letters, digits and underscores, a letter first.",
                )


def check_places(kind: str, owned: Iterable[tuple[Any, str, str]], lab: Layer) -> None:
    """Refuse two devices in one place.

    Args:
        kind: of place, for the message.
        owned: each place, the device there, and the place in words.
        lab: the lab file.

    Raises:
        ConfigError: with the line of the second one.
    """
    owners: dict[Any, str] = {}
    for value, name, words in owned:
        owner = owners.setdefault(value, name)
        if owner != name:
            raise ConfigError(
                f"{owner} and {name} have one {kind}: {words}",
                where=lab.place(("devices", name)),
                remedy="A device has one driver.",
            )


def require_device(name: str, settings: LabSettings, place: str) -> None:
    """Refuse the name of a device that the lab does not have."""
    if name not in settings.devices:
        raise ConfigError(
            f"there is no device {name!r}",
            where=place,
            remedy=f"There is: {', '.join(settings.devices)}.",
        )
