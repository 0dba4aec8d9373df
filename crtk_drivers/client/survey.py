"""Which CRTK devices there are on ROS, and why one is as it is."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from crtk_drivers.client.discovery import POLL, SETTLE, devices
from crtk_drivers.client.remote import RemoteDevice
from crtk_drivers.client.space import NotOffered, Space
from crtk_drivers.errors import CrtkError
from crtk_drivers.ros import environment
from crtk_drivers.state import Status

LOOK_TIME = 4.0
"""Seconds in which another node is found: three when the first exchange is lost, and some more."""
STATUS_TIME = 2.0
"""Seconds in which a device that was found must tell its operating state."""
DIAGNOSTICS = "/diagnostics"


def survey(timeout: float = LOOK_TIME) -> Mapping[str, Status | None]:
    """Return the namespaces of the CRTK devices that are found, with the state of each.

    Returns as soon as nothing new has appeared for a second. None: it is silent.

    Raises:
        MissingExtra, ConfigError: ROS 2 cannot be used here.
    """
    environment.check()
    from crtk_drivers.ros.link import Link

    link = Link()
    try:
        link.start()
        deadline = time.monotonic() + timeout
        found: set[str] = set()
        settled = deadline
        while time.monotonic() < min(deadline, settled):
            seen = devices(link)
            if seen != found:
                found, settled = seen, time.monotonic() + SETTLE
            time.sleep(POLL)
        return {
            namespace: _status(Space(link, namespace, STATUS_TIME)) for namespace in sorted(found)
        }
    finally:
        link.close()


def _status(space: Space) -> Status | None:
    try:
        return space.status().latest
    except (CrtkError, NotOffered):
        return None


@dataclass(frozen=True)
class Report:
    """What /diagnostics says of the state of a device.

    Attributes:
        text: in words; empty if it says nothing.
        connecting: the driver's first attempt to reach the hardware is not over.
    """

    text: str = ""
    connecting: bool = False


def reported(device: RemoteDevice, timeout: float) -> Report:
    """Return the next report on a device, or an empty one if none comes in `timeout` s."""
    prefix = device.namespace.rstrip("/")
    told: list[Report] = []
    arrived = threading.Event()

    def listen(message: Any) -> None:
        for status in message.status:
            node, _, thing = status.name.partition(": ")
            if thing == "device" and node.rpartition("/")[0] == prefix:
                values = {value.key: value.value for value in status.values}
                told.append(Report(status.message, values.get("connecting") == str(True)))
                arrived.set()

    stop = device.on_message(DIAGNOSTICS, listen)
    arrived.wait(timeout)
    stop()
    return told[-1] if told else Report()
