"""A look at the devices of a lab on ROS, whichever machines they run on."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Final

from crtk_drivers.client.clock_offset import measured_offset
from crtk_drivers.client.discovery import POLL, Catalogue
from crtk_drivers.client.heard_devices import HeardDevice, heard_devices
from crtk_drivers.client.survey import LATEST
from crtk_drivers.errors.wording import printable
from crtk_drivers.labs.seen import Seen
from crtk_drivers.ros.presence import Word

__all__ = ["Looked", "look"]

SHORTEST: Final = 2.0
"""Seconds to look at least: a second driver in a namespace may be found later than the first."""


@dataclass(frozen=True, slots=True)
class Looked:
    """What was seen of a device.

    Attributes:
        seen: how it is, with the offset of its clock.
        drivers: in its namespace, the one that serves first.
        driver_version, crtk_version: as its driver says; empty where it was not heard.
    """

    seen: Seen
    drivers: tuple[Word, ...] = ()
    driver_version: str = ""
    crtk_version: str = ""

    @property
    def is_complete(self) -> bool:
        """Whether all is known but the offset."""
        return bool(self.seen.state and self.seen.host and self.driver_version)


def look(namespaces: Mapping[str, str], domain: int | None = None) -> dict[str, Looked]:
    """Look for devices, until all are found, or nothing new appears for as long as DDS may take.

    Args:
        namespaces: by the names of the devices.
        domain: of ROS; None: that of the environment.
    """
    from crtk_drivers.client.ros_link import Link  # not before the environment is that of the lab

    with closing(Link("crtk_lab_check", domain=domain)) as link:
        devices = heard_devices(link, namespaces)
        manifests = {name: Catalogue(link, space) for name, space in namespaces.items()}
        link.start()
        began = settled = time.monotonic()
        found: dict[str, Looked] = {}
        while (now := time.monotonic()) < settled + LATEST:
            before = [each.is_complete for each in found.values()]
            found = {name: _looked(device, manifests[name]) for name, device in devices.items()}
            after = [each.is_complete for each in found.values()]
            if all(after) and now > began + SHORTEST:
                break
            settled = settled if before == after else now
            time.sleep(POLL)
        for name, each in found.items():
            if each.seen.seen:
                caller = link.state_caller(f"{devices[name].namespace}/operating_state")
                if offset := measured_offset(caller):
                    seen = replace(each.seen, offset=offset.value, uncertainty=offset.uncertainty)
                    found[name] = replace(each, seen=seen)
        return found


def _looked(device: HeardDevice, catalogue: Catalogue) -> Looked:
    catalogue.look()
    manifest = catalogue.manifest
    versions = (
        printable(str(manifest.get(key, "")), keeping="")
        for key in ("driver_version", "crtk_version")
    )
    return Looked(device.seen(), device.drivers(), *versions)
