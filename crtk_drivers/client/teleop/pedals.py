"""Pedals as sensor_msgs/Joy, in the dVRK's convention: one topic a pedal, 1 is pressed, else it is not."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from typing import Final, Protocol

from crtk_drivers.client.inbox import Received, Unreadable
from crtk_drivers.client.ros_link import Link
from crtk_drivers.client.teleop.side import LATE
from crtk_drivers.motion.teleop.both_sides import Heard
from crtk_drivers.motion.teleop.teleop_settings import PedalSettings, TeleopSettings
from crtk_drivers.ros.plain import message_class
from crtk_drivers.status.throttle import Throttle

logger = logging.getLogger(__name__)

JOY: Final = "sensor_msgs/msg/Joy"
PRESSED: Final = 1
_WARNING_INTERVAL: Final = 5.0


class Pedal(Protocol):
    """Something that is pressed or not.

    Attributes:
        doubt: why it does not count, whatever it tells; empty if it does.
    """

    @property
    def doubt(self) -> str:
        """See above."""

    def read(self) -> Heard[bool] | None:
        """Return whether it is pressed, and since when that is known; None if nothing is known."""


class TopicPedal:
    """One button of a Joy. A stamp of 0 is CRTK's mark of what is not valid, here as elsewhere.

    Args:
        link: to ROS.
        settings: with a topic.
    """

    def __init__(self, link: Link, settings: PedalSettings) -> None:
        self._link = link
        self._settings = settings
        self._stamp_ns = 0
        self._newest: Received | None = None
        self._inbox = link.inbox(settings.topic, message_class(JOY))
        self._inbox.add_listener(self._hear)
        self._warnings = Throttle(_WARNING_INTERVAL)

    def _hear(self, received: Received) -> None:
        """Keep it; after one that comes late, or twice, nothing is known until the next."""
        stamp_ns = received.wall_ns
        is_late = stamp_ns != 0 and 0 < self._stamp_ns - stamp_ns < LATE * 1e9
        if not is_late:
            self._stamp_ns = stamp_ns or self._stamp_ns
        self._newest = None if is_late else received

    @property
    def doubt(self) -> str:
        """See `Pedal`: two that tell of one pedal may tell of two feet, whether both are heard or not."""
        tell = self._link.publishers(self._settings.topic)
        return (
            f"{self._settings.topic} is told by {tell} publishers, not by one" if tell > 1 else ""
        )

    def read(self) -> Heard[bool] | None:
        """See `Pedal`."""
        received = self._newest
        if received is None or received.wall_ns == 0 or not self._inbox.connected:
            return None
        try:
            buttons = received.message.buttons
            pressed = buttons[self._settings.button] == PRESSED
        except (Unreadable, IndexError) as error:
            if self._warnings.passes(self._settings.topic, time.monotonic()):
                logger.warning(
                    "%s has no button %d that can be read: %s",
                    self._settings.topic,
                    self._settings.button,
                    error,
                )
            return None
        return Heard(bool(pressed), received.since)


def topic_pedals(link: Link, settings: TeleopSettings) -> Mapping[str, TopicPedal]:
    """Return the pedals of the settings that are topics, as ``clutch`` and ``engage``."""
    given = {"clutch": settings.clutch, "engage": settings.engage}
    return {
        name: TopicPedal(link, pedal)
        for name, pedal in given.items()
        if pedal is not None and pedal.topic
    }
