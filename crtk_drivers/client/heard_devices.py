"""What is heard of the drivers of some devices, while it is: who they are, where they run, and how they are.

What counts is what is heard: of a process that was killed DDS keeps the endpoints for a while, and of a
machine that was unplugged, too.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from crtk_drivers.client.inbox import Inbox, Received
from crtk_drivers.client.survey import DIAGNOSTICS
from crtk_drivers.client.told_health import Told, told_of
from crtk_drivers.errors.wording import printable
from crtk_drivers.labs.reports import FRESH
from crtk_drivers.labs.seen import Seen
from crtk_drivers.ros.names import AMONG_DRIVERS
from crtk_drivers.ros.plain import message_class
from crtk_drivers.ros.presence import GONE_AFTER, Word, read_word
from crtk_drivers.state import Status

if TYPE_CHECKING:
    from crtk_drivers.client.ros_link import Link

__all__ = ["HeardDevice", "heard_devices"]


class HeardDevice:
    """What is heard of the drivers in one namespace. Thread-safe.

    Args:
        name: of the device, in the lab.
        namespace: full.
        changed: called when an operating state is another, by the thread that spins.
    """

    def __init__(self, name: str, namespace: str, changed: Callable[[], None]) -> None:
        self.name = name
        self.namespace = namespace
        self._changed = changed
        self._lock = threading.Lock()
        self._heard = -math.inf
        self._status: Status | None = None
        self._told: dict[str, Told] = {}
        self._told_at = -math.inf
        self._words: dict[str, tuple[Word, float]] = {}

    def hear_state(self, received: Received) -> None:
        """Take a message on ``operating_state``."""
        status = received.status
        with self._lock:
            is_other = self._status is None or status.state is not self._status.state
            self._status, self._heard = status, received.arrived
        if is_other:
            self._changed()

    def hear_word(self, received: Received) -> None:
        """Take a message on ``drivers``."""
        word = read_word(received.text)
        if word is None:
            return
        with self._lock:
            if word.there:
                self._words[word.key] = word, received.arrived
                self._heard = received.arrived
            else:
                self._words.pop(word.key, None)

    def hear_health(self, told: Told, arrived: float) -> None:
        """Take a status on /diagnostics."""
        with self._lock:
            self._told[told.thing] = told
            self._heard = self._told_at = arrived

    def drivers(self) -> tuple[Word, ...]:
        """Return the drivers in this namespace, the one that serves first."""
        since = time.monotonic() - GONE_AFTER
        with self._lock:
            self._words = {key: each for key, each in self._words.items() if each[1] > since}
            found = [word for word, _ in self._words.values()]
        return tuple(sorted(found, key=lambda word: word.rank))

    def seen(self) -> Seen:
        """Return how it is, but for the offset of its clock."""
        drivers = self.drivers()
        with self._lock:
            ago = time.monotonic() - self._heard
            if ago > GONE_AFTER:
                return Seen(self.name, False, ago=None if math.isinf(ago) else round(ago, 1))
            is_told = time.monotonic() - self._told_at <= GONE_AFTER
            told = dict(self._told) if is_told else {}
            status = self._status
        state = "" if status is None else str(status.state)
        return Seen(
            self.name,
            True,
            state=state,
            cause=_cause(told.get("device"), state),
            is_busy=status is not None and status.is_busy,
            is_homed=status is not None and status.is_homed,
            measures=_measures(told.get("bus")),
            host=drivers[0].host if drivers else "",
        )


def heard_devices(
    link: Link, namespaces: Mapping[str, str], changed: Callable[[], None] = lambda: None
) -> dict[str, HeardDevice]:
    """Begin to hear the drivers of some devices; return what is heard, by the names of the devices.

    Args:
        link: to ROS.
        namespaces: full, by the names of the devices.
        changed: called when an operating state is another, by the thread that spins.
    """
    found = {name: HeardDevice(name, space, changed) for name, space in namespaces.items()}
    by_space = {device.namespace.rstrip("/"): device for device in found.values()}

    def hear_health(received: Received) -> None:
        for told in told_of(received.message):
            if told.namespace in by_space:
                by_space[told.namespace].hear_health(told, received.arrived)

    for space, device in by_space.items():
        state = message_class("crtk_msgs/msg/OperatingState")
        _volatile(link, f"{space}/operating_state", state).add_listener(device.hear_state)
        link.text_inbox(f"{space}/{AMONG_DRIVERS}", latched=False).add_listener(device.hear_word)
    reports = message_class("diagnostic_msgs/msg/DiagnosticArray")
    _volatile(link, DIAGNOSTICS, reports).add_listener(hear_health)
    return found


def _volatile(link: Link, topic: str, kind: type) -> Inbox:
    """Return the subscription of what is said from now on: what was said before tells of nobody now."""
    return link.inbox(topic, kind, latched=False)


def _cause(device: Told | None, state: str) -> str:
    """Return what a driver says of its state; nothing where it said that of the state before."""
    if device is None or device.values.get("operating_state", state) != state:
        return ""
    return "" if device.text == state else printable(device.text, keeping="")


def _measures(bus: Told | None) -> bool:
    if bus is None or bus.values.get("connected") != str(True):
        return False
    try:
        age = float(bus.values.get("sample age (ms)", "nan")) / 1e3
    except ValueError:
        return False
    return age < FRESH
