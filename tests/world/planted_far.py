"""Mistakes that are planted between a device and its clients on ROS 2: in its node, or in the client."""

from __future__ import annotations

from typing import Any

from world.planted_table import FAR, LEFT, MOVES, NOT_ENABLED, planted

from crtk_drivers.client.remote import RemoteDevice
from crtk_drivers.ros.publishing import PublishingThread
from crtk_drivers.ros.subscriptions import CommandTopics


@planted("copley", FAR, MOVES, seeds=60)
def node_passes_over_a_hold() -> None:
    """Each second `hold` that comes to the node is confirmed to its client, and not carried out."""
    plain = CommandTopics.submit
    holds = 0

    def submit(self: Any, name: str, *given: Any) -> None:
        nonlocal holds
        holds += name == "hold"
        if name != "hold" or holds % 2:
            plain(self, name, *given)

    CommandTopics.submit = submit


@planted("copley", FAR, MOVES, NOT_ENABLED, seeds=150)
def stop_counts_as_arrived_when_sent() -> None:
    """The client takes a stop for carried out as soon as it has sent it."""
    RemoteDevice._require_arrival = lambda *given: None


@planted("robotiq", FAR, LEFT, seeds=5)
def publishing_thread_outlives_its_node() -> None:
    """The thread that publishes is not told to end."""
    PublishingThread.stop = lambda self, timeout: True
