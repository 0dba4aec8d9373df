"""Quality of service, as the official CRTK client and the reference implementation need it.

Everything is RELIABLE: the client subscribes so, and a best-effort publisher would never match it.
What the device *receives* is always VOLATILE: the client's ``state_command`` is latched, and a device
that asked for latched messages would get an old ``enable`` replayed whenever it starts.

Each of them can be overridden by parameters: ``-p qos_overrides./ur5/measured_js.publisher.depth:=1``. A
topic has these parameters only if one of them was given: five hundred of them would hide the node's own.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from copy import copy
from typing import Any

from rclpy.event_handler import (
    PublisherEventCallbacks,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from crtk_drivers.commands import Command, Level
from crtk_drivers.ros.unlocked import UnlockedNode

logger = logging.getLogger(__name__)


def _profile(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


DATA = _profile(10, DurabilityPolicy.VOLATILE)
OPERATING_STATE = _profile(10, DurabilityPolicy.TRANSIENT_LOCAL)
REFUSALS = _profile(10, DurabilityPolicy.TRANSIENT_LOCAL)
ROSOUT = _profile(1000, DurabilityPolicy.TRANSIENT_LOCAL)
LATCHED = _profile(1, DurabilityPolicy.TRANSIENT_LOCAL)
TF = _profile(100, DurabilityPolicy.VOLATILE)

NEWEST = _profile(1, DurabilityPolicy.VOLATILE)
"""For absolute commands: an older one is worth nothing."""
EVERY = _profile(10, DurabilityPolicy.VOLATILE)
"""For free, and trajectories, of which one without points is a stop: each counts."""
STOPS = _profile(1000, DurabilityPolicy.VOLATILE)
"""For state_command and hold: each counts, also beside a client that sends 40 000 a second for 25 ms."""
INCREMENTS = _profile(200, DurabilityPolicy.VOLATILE)
"""For relative commands: a lost one is lost motion. 200 of them are 0.4 s at 500 Hz."""

CONFIRMED = _profile(1, DurabilityPolicy.VOLATILE)
"""For who sends a stop, or something else once, and wants to know that it arrived.

Fast DDS asks for that with each message where its history is full, as this one always is, else every 3 s.
"""

STOPPING = frozenset({"state_command", "hold"})
"""Commands that are stops, or may be."""

OVERRIDES = QoSOverridingOptions.with_default_policies()
NO_OVERRIDES = QoSOverridingOptions(())


def of_command(command: Command) -> QoSProfile:
    """Return the profile with which the device subscribes to `command`."""
    if command.name in STOPPING:
        return STOPS
    if not command.is_motion:
        return EVERY
    return INCREMENTS if command.is_relative else NEWEST


def of_feedback(command: Command) -> QoSProfile:
    """Return the profile with which the device publishes `command`."""
    return LATCHED if command.level in (Level.GOAL, Level.SETTING) else DATA


def as_offered(profiles: Iterable[QoSProfile], depth: int) -> QoSProfile:
    """Return the profile that hears all of some publishers, what they said before too if all keep that."""
    found = tuple(profiles)
    is_reliable = all(each.reliability is ReliabilityPolicy.RELIABLE for each in found)
    is_latched = bool(found) and all(
        each.durability is DurabilityPolicy.TRANSIENT_LOCAL for each in found
    )
    return QoSProfile(
        depth=depth,
        history=HistoryPolicy.KEEP_LAST,
        reliability=ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE,
    )


_POLICY_NAMES = {kind.value: kind.name.lower() for kind in QoSPolicyKind}


def publisher(
    node: UnlockedNode,
    kind: type,
    topic: str,
    profile: QoSProfile,
    matched: Callable[[Any], None] | None = None,
) -> Publisher:
    """Create a publisher that parameters can override, and that says whom it cannot serve.

    `matched` is called by the executor when a subscriber comes or goes, if the middleware tells that.
    """
    unserved = _OnceTold(
        f"a subscriber of {topic} asks for another %s than is published, and gets nothing; "
        "let it ask for reliable and volatile"
    )

    def create(**events: Any) -> Publisher:
        return node.create_publisher(
            kind,
            topic,
            copy(profile),  # rclpy writes the overrides into it
            qos_overriding_options=_overriding(node, topic, "publisher"),
            event_callbacks=PublisherEventCallbacks(
                incompatible_qos=unserved, use_default_callbacks=False, **events
            ),
        )

    try:
        return create(matched=matched)
    except UnsupportedEventTypeError:
        return create()


def subscription(
    node: UnlockedNode,
    kind: type,
    topic: str,
    receive: Callable[[Any], None],
    profile: QoSProfile,
    raw: bool = False,
) -> Subscription:
    """Create a subscription that parameters can override, and that says whom it cannot hear.

    With `raw`, `receive` gets the message's bytes.
    """
    unheard = _OnceTold(
        f"a publisher on {topic} offers another %s than is needed, and is not heard; "
        "let it publish reliably"
    )
    return node.create_subscription(
        kind,
        topic,
        receive,
        copy(profile),
        raw=raw,
        qos_overriding_options=_overriding(node, topic, "subscription"),
        event_callbacks=SubscriptionEventCallbacks(
            incompatible_qos=unheard, use_default_callbacks=False
        ),
    )


def _overriding(node: UnlockedNode, topic: str, endpoint: str) -> QoSOverridingOptions:
    """Return which policies become parameters: none, unless one was given for this end of the topic."""
    name = f"qos_overrides.{node.resolve_topic_name(topic)}.{endpoint}."
    return OVERRIDES if node.has_overrides(name) else NO_OVERRIDES


class _OnceTold:
    def __init__(self, text: str) -> None:
        self._text = text
        self._told = False

    def __call__(self, event: Any) -> None:
        if not self._told:
            self._told = True
            policy = _POLICY_NAMES.get(int(event.last_policy_kind), "quality of service")
            logger.warning(self._text, policy)
