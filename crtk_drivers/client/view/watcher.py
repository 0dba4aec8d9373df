"""Which devices there are on the graph, each as it is seen, while somebody looks."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Self

from crtk_drivers.client.discovery import devices
from crtk_drivers.client.ros_link import Link
from crtk_drivers.client.survey import DIAGNOSTICS
from crtk_drivers.client.told_health import told_of
from crtk_drivers.client.view.newest_values import Sampler
from crtk_drivers.client.view.watched import WatchedDevice
from crtk_drivers.errors import ConfigError
from crtk_drivers.kinematics.joint_axes import matrix_of
from crtk_drivers.ros import environment
from crtk_drivers.ros.names import DESCRIPTION, checked_namespace
from crtk_drivers.ros.plain import message_class
from crtk_drivers.samples import Array

logger = logging.getLogger(__name__)

PERIOD: Final = 0.5
"""Seconds between two looks at the graph."""
UNWATCHED: Final = 5.0
"""Seconds after the last look from which on nobody looks: values are not received any more."""

SETTLED: Final = 1.0
"""Seconds without a new device after which all that are there count as found."""

LAB_FILES: Final = (".toml", ".yaml", ".yml")
"""What the name of a lab file ends with."""

Report = tuple[str, str, int, Mapping[str, str]]
"""Of what, in words, level (0 to 3: as diagnostic_msgs has it), and values."""


class Watcher:
    """The devices on the graph. `looked` tells it that somebody looks. A context manager.

    Args:
        namespaces: of the devices that are wanted; none: all that appear.
    """

    def __init__(self, namespaces: Sequence[str] = ()) -> None:
        self._link = Link("crtk_view")
        self._sampler = Sampler(self._link)
        self._all = not namespaces
        self._devices = {name: self._watched(name) for name in namespaces}
        self._reports: dict[str, dict[str, Report]] = {}
        self._on_settled: Callable[[WatchedDevice], object] = id
        self._looked = time.monotonic()
        self._awake = threading.Event()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._settle_all, name="view", daemon=True)

    def start(self) -> None:
        """Begin to look for devices."""
        self._link.start()
        reports = self._link.inbox(
            DIAGNOSTICS, message_class("diagnostic_msgs/msg/DiagnosticArray"), latched=False
        )
        reports.add_listener(lambda received: self._report(received.message))
        self._thread.start()

    def hear(self, topic: str, ros_type: str, callback: Callable[[Any], None]) -> None:
        """Call `callback` with each message of a topic that is latched; not if its type is not known here."""
        try:
            inbox = self._link.inbox(topic, message_class(ros_type), latched=True)
        except ConfigError as error:
            logger.info("%s is not heard: %s", topic, error)
            return
        inbox.add_listener(lambda received: callback(received.message))

    def on_settled(self, callback: Callable[[WatchedDevice], object]) -> None:
        """Call `callback` each time that a device has been looked at, from a thread that may wait."""
        self._on_settled = callback

    def close(self) -> None:
        """Leave all of them; they go on as they are."""
        self._over.set()
        self._awake.set()
        if self._thread.is_alive():
            self._thread.join()
        self._sampler.close()
        self._link.close()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def looked(self) -> None:
        """Somebody looks now."""
        self._looked = time.monotonic()
        self._awake.set()

    def wait(self, timeout: float) -> bool:
        """Wait until all that is looked at has a value, and nothing new appears; False if not in time, s."""
        deadline = time.monotonic() + timeout
        known, settled = 0, time.monotonic()
        while (now := time.monotonic()) < deadline:
            self.looked()
            devices = list(self)
            if len(devices) != known or not all(device.is_complete for device in devices):
                known, settled = len(devices), now
            if known and now - settled > SETTLED:
                return True
            self._over.wait(PERIOD / 10.0)
        return False

    @property
    def is_watched(self) -> bool:
        """Whether anybody looks."""
        return time.monotonic() - self._looked < UNWATCHED

    def __iter__(self) -> Iterator[WatchedDevice]:
        return iter(tuple(self._devices.values()))

    def get(self, namespace: str) -> WatchedDevice | None:
        """Return a device, None if it is not known."""
        return self._devices.get(namespace)

    def reports(self, namespace: str) -> Mapping[str, Report]:
        """Return what /diagnostics says of a device, by the thing that it is about."""
        return self._reports.get(namespace, {})

    # ------------------------------------------------------------------------------------- a thread

    def _watched(self, namespace: str) -> WatchedDevice:
        return WatchedDevice(self._link, self._sampler, namespace)

    def _settle_all(self) -> None:
        while not self._over.is_set():
            if not self.is_watched:
                for device in self:
                    device.leave()
                self._awake.clear()
                if not self.is_watched:
                    self._awake.wait()
                continue
            if self._all:
                self._find()
            for device in self:
                if self._over.is_set():
                    return
                try:
                    device.settle(self._description_of_all)
                    self._on_settled(device)
                except Exception:  # one device must not end the view of the others
                    logger.exception("%s cannot be looked at", device.namespace)
            self._over.wait(PERIOD)

    def _find(self) -> None:
        for namespace in sorted(devices(self._link) - set(self._devices)):
            self._devices[namespace] = self._watched(namespace)

    def _description_of_all(self) -> str | None:
        topic = f"/{DESCRIPTION}"
        return topic if self._link.publishers(topic) else None

    def _report(self, message: Any) -> None:
        for told in told_of(message):
            found = self._reports.setdefault(told.namespace, {})
            found[told.thing] = (told.thing, told.text, told.level, told.values)


@dataclass(frozen=True)
class Wanted:
    """Which devices a user wants to see.

    Attributes:
        namespaces: none: all.
        mounted: sensors on an arm, by their namespace: that of the arm, and where they are in its tool frame
            (4, 4).
    """

    namespaces: tuple[str, ...] = ()
    mounted: Mapping[str, tuple[str, Array]] = field(default_factory=dict)


def wanted(arguments: Sequence[str]) -> Wanted:
    """Return what a user means by namespaces, or by a lab file, whose devices it is then.

    Raises:
        ConfigError: that is no namespace, or a lab file that is wrong.
    """
    from crtk_drivers.labs.lab_outline import load_outline

    found: list[str] = []
    mounted: dict[str, tuple[str, Array]] = {}
    for each in arguments:
        if not each.endswith(LAB_FILES):
            found.append(checked_namespace(f"/{each.strip('/')}", option=""))
            continue
        lab = load_outline(each)  # settings of hardware matter to `up` alone
        environment.adopt(lab.environment)
        environment.share_no_memory()
        namespaces = lab.namespaces()
        found += namespaces.values()
        for name, entry in lab.entries().items():
            if entry.on in namespaces:
                mounting = matrix_of(entry.mounting.pose)
                mounted[namespaces[name]] = (namespaces[entry.on], mounting)
    return Wanted(tuple(dict.fromkeys(found)), mounted)
