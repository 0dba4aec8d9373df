"""One device as it is seen from outside, now: state, values, shape, health, refusals."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from crtk_drivers.client.space import NotOffered, Space
from crtk_drivers.client.view.drawable import DRAWN
from crtk_drivers.client.view.newest_values import joints_in
from crtk_drivers.commands import Command, Direction, Level
from crtk_drivers.device import READINGS
from crtk_drivers.errors import CommandRefused, CrtkError
from crtk_drivers.kinematics.drawn import DrawnChain, drawn
from crtk_drivers.kinematics.urdf import urdf_of_joints
from crtk_drivers.ros.names import DESCRIPTION
from crtk_drivers.ros.plain import message_class
from crtk_drivers.state import Status

if TYPE_CHECKING:
    from crtk_drivers.client.inbox import Inbox, Received
    from crtk_drivers.client.ros_link import Link
    from crtk_drivers.client.view.newest_values import Sampled, Sampler, Seen

logger = logging.getLogger(__name__)

FIRST: Final = ("measured_js", "setpoint_js", "measured_cp", "measured_cf")
"""What is looked at of every device; other values when somebody asks for them."""
MOST: Final = 24
"""Values of one device that are looked at, at most."""
TIMEOUT: Final = 2.0
"""Seconds in which the other end of a topic must be found."""
REFUSALS: Final = 8
"""That are kept."""


@dataclass(frozen=True, slots=True)
class Refused:
    """A refusal, and when it was heard (wall clock, s)."""

    refusal: CommandRefused
    at: float


class WatchedDevice:
    """One device. `settle` is called again and again by a thread that may wait; all else does not wait.

    Args:
        link: to ROS.
        sampler: for its values.
        namespace: full.
    """

    def __init__(self, link: Link, sampler: Sampler, namespace: str) -> None:
        self.namespace = namespace
        self.space = Space(link, namespace, TIMEOUT)
        self.manifest: Mapping[str, Any] = {}
        self.chain: DrawnChain | None = None
        self.problem = "looking for it"
        """Why it is not known; empty if it is."""
        self.refusals: deque[Refused] = deque(maxlen=REFUSALS)
        self._sampler = sampler
        self._lock = threading.Lock()
        self._topics: dict[str, Sampled] = {}
        self._offered: dict[str, tuple[str, str, str]] = {}
        self._wanted = set(FIRST)
        self._told: Inbox | None = None
        self._read = 0
        self._is_followed = False

    # -------------------------------------------------------------------------------- what may wait

    def settle(self, descriptions: Callable[[], str | None]) -> None:
        """Learn what it offers now, and begin to look at what is wanted of it.

        Args:
            descriptions: the topic of a description of all robots, if there is one.
        """
        try:
            features = self.space.features()
            self.problem = "" if features else "nobody is there"
            self.manifest = self.space.catalogue.manifest
            self._offered = self._values(features)
            if not self._is_followed and "operating_state" in features:
                self.space.status().on_refusal(self._refused)
                self._is_followed = True
        except (CrtkError, NotOffered) as error:
            self.problem = str(error)
        self._look_at_wanted()
        self._read_description(descriptions)

    def _values(self, features: Mapping[str, Any]) -> dict[str, tuple[str, str, str]]:
        """Return topic, type and units of what can be drawn, by name."""
        found = {
            name: (feature.topic, feature.ros_type, feature.command.units)
            for name, feature in features.items()
            if _is_drawn(feature.command)
        }
        for name, row in (self.manifest.get("readings") or {}).items():
            found[f"{READINGS}/{name}"] = (row["name"], row["type"], "")
        return found

    def _look_at_wanted(self) -> None:
        for name in sorted(self._wanted & set(self._offered)):
            if name not in self._topics:
                topic, ros_type, _ = self._offered[name]
                try:
                    sampled = self._sampler.topic(topic, message_class(ros_type))
                except CrtkError as error:
                    logger.warning("%s: %s is not shown: %s", self.namespace, name, error)
                    self._wanted.discard(name)
                    continue
                with self._lock:
                    self._topics[name] = sampled

    def _read_description(self, shared: Callable[[], str | None]) -> None:
        link = self.space.link
        if self._told is None:
            own = f"{self.space.catalogue.prefix}{DESCRIPTION}"
            topic = own if link.publishers(own) else shared()
            if topic is None:
                return
            self._told = link.text_inbox(topic)
        received: Received | None = self._told.latest
        names = self._joint_names()
        if received is None or not names or received.serial == self._read:
            return
        self._read = received.serial
        try:
            self.chain = drawn(urdf_of_joints(received.text, names, where=self._told.topic))
        except (CrtkError, ValueError) as error:
            self.chain = None
            logger.warning("%s cannot be drawn: %s", self.namespace, error)

    def _joint_names(self) -> tuple[str, ...]:
        told = tuple(joint["name"] for joint in self.manifest.get("joints", ()))
        if told:
            return told
        found = joints_in(self.look())
        return () if found is None else found[0].name

    # ------------------------------------------------------------------------------ what does not

    def want(self, name: str) -> bool:
        """Look at another value from now on; False if it has no such value, or too many are looked at."""
        if name not in self._offered or len(self._wanted) >= MOST:
            return name in self._wanted
        self._wanted.add(name)
        return True

    def leave(self) -> None:
        """Look at its values no more, until `settle` is called again."""
        with self._lock:
            topics, self._topics = self._topics, {}
        for sampled in topics.values():
            self._sampler.leave(sampled)
        self._wanted = set(FIRST)

    def look(self) -> dict[str, Seen]:
        """Return the newest values that are looked at, by name."""
        with self._lock:
            seen = {name: sampled.look() for name, sampled in self._topics.items()}
        return {name: each for name, each in seen.items() if each is not None}

    @property
    def is_complete(self) -> bool:
        """Whether all has a value that is looked at and offered, and it can be drawn if it is told how."""
        wanted = self._wanted & set(self._offered)
        return not self.problem and wanted <= set(self.look())

    @property
    def offered(self) -> Mapping[str, str]:
        """What can be looked at, with its units."""
        return {name: units for name, (_, _, units) in self._offered.items()}

    def status(self) -> Status | None:
        """Return the operating state as heard last; None if none was heard yet."""
        tracker = self.space.tracker
        return tracker.latest if tracker is not None and tracker.has_status else None

    def silence(self) -> str:
        """Return why it counts as gone; empty if it does not."""
        if self.problem:
            return self.problem
        tracker = self.space.tracker
        return "" if tracker is None else tracker.lost()

    def _refused(self, refusal: CommandRefused) -> None:
        self.refusals.append(Refused(refusal, time.time()))


def _is_drawn(command: Command) -> bool:
    return (
        command.direction is Direction.PUBLISHED
        and command.level in (Level.MEASURED, Level.SETPOINT)
        and command.payload in DRAWN
    )
