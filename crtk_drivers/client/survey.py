"""Which CRTK devices there are on ROS, and why one is as it is."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from crtk_drivers.client.discovery import POLL, devices
from crtk_drivers.client.remote import RemoteDevice
from crtk_drivers.client.space import NotOffered, Space
from crtk_drivers.client.told_health import told_of
from crtk_drivers.errors import CrtkError
from crtk_drivers.ros import environment
from crtk_drivers.state import OperatingState, Status

if TYPE_CHECKING:
    from crtk_drivers.client.ros_link import Link

LOOK_TIME = 8.0
"""Longest time to look, in s."""
LATEST = 3.5
"""Seconds in which a node that is there is found: three when the first exchange is lost, and some more."""
STATUS_TIME = 2.0
"""Seconds in which a device that was found must tell its operating state."""
REPORT_TIME = 2.0
"""Seconds to wait for a report on /diagnostics, of which a driver makes one a second."""
DIAGNOSTICS = "/diagnostics"


def survey(timeout: float = LOOK_TIME) -> Mapping[str, Status | None]:
    """Return the namespaces of the CRTK devices that are found, with the state of each.

    Returns when nothing new has appeared for as long as a first exchange may take. None: it is silent. Which
    of those in FAULT have never been connected yet is known from /diagnostics.

    Raises:
        MissingExtra, ConfigError: ROS 2 cannot be used here.
    """
    environment.check()
    from crtk_drivers.client.ros_link import Link
    from crtk_drivers.ros.plain import message_class

    link = Link()
    try:
        link.start()
        reports = _Reports()
        told = link.inbox(DIAGNOSTICS, message_class("diagnostic_msgs/msg/DiagnosticArray"))
        told.add_listener(lambda received: reports.take(received.message))
        deadline = time.monotonic() + timeout
        found: set[str] = set()
        settled = time.monotonic() + LATEST
        while time.monotonic() < min(deadline, settled):
            seen = devices(link)
            if seen != found:
                found, settled = seen, time.monotonic() + LATEST
            time.sleep(POLL)
        return {namespace: _status(link, namespace, reports) for namespace in sorted(found)}
    finally:
        link.close()


def _status(link: Link, namespace: str, reports: _Reports) -> Status | None:
    try:
        status = Space(link, namespace, STATUS_TIME).status().latest
    except (CrtkError, NotOffered):
        return None
    if status.state is OperatingState.FAULT:
        report = reports.wait(namespace)
        status = replace(status, detail=report.text, connecting=report.connecting)
    return status


@dataclass(frozen=True)
class Report:
    """What /diagnostics says of the state of a device.

    Attributes:
        text: in words; empty if it says nothing.
        connecting: the driver's first attempt to reach the hardware is not over.
    """

    text: str = ""
    connecting: bool = False


class _Reports:
    """The last report on each device, by its namespace."""

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        self._last: dict[str, Report] = {}

    def take(self, message: Any) -> None:
        """Keep what a message on /diagnostics says of devices."""
        with self._arrived:
            for told in told_of(message):
                if told.thing == "device":
                    report = Report(told.text, told.values.get("connecting") == str(True))
                    self._last[told.namespace] = report
            self._arrived.notify_all()

    def wait(self, namespace: str) -> Report:
        """Return the last report, or the first to come within `REPORT_TIME`, or else an empty one."""
        name = namespace.rstrip("/")
        with self._arrived:
            self._arrived.wait_for(lambda: name in self._last, REPORT_TIME)
            return self._last.get(name, Report())


def reported(device: RemoteDevice) -> Report:
    """Return the next report on a device, or an empty one if none comes in `REPORT_TIME`."""
    reports = _Reports()
    stop = device.on_message(DIAGNOSTICS, reports.take)
    try:
        return reports.wait(device.namespace)
    finally:
        stop()
