"""Subscriptions: one for each command and input that the device offers, and for none besides.

A callback converts, hands over to the engine, which checks everything, and returns; it never waits and
touches no bus. What is refused is counted and told by the engine; nothing raises into the executor.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from rclpy.subscription import Subscription

from crtk_drivers.commands import Command, Direction, Payload
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.ros import qos
from crtk_drivers.ros.messages import TYPES, stamp_ns, value_of
from crtk_drivers.ros.names import Frames
from crtk_drivers.ros.senders import AttributedSubscription, Sender, Senders
from crtk_drivers.ros.unlocked import UnlockedNode
from crtk_drivers.samples import Value
from crtk_drivers.status.throttle import Throttle

logger = logging.getLogger(__name__)

FAILURE_INTERVAL = 2.0


class CommandTopics:
    """The subscriptions of one device.

    Args:
        node: of the driver.
        engine: of the device.
        frames: names of its frames.
        admit: called with each command, and what it says if it is a state command; may refuse it.

    Attributes:
        senders: of what arrived on them.
    """

    def __init__(
        self, node: UnlockedNode, engine: Engine, frames: Frames, admit: Callable[..., None]
    ) -> None:
        self._engine = engine
        self._admit = admit
        self._frames = frames
        engine.tell_frames(frames.outgoing)
        self._failures = Throttle(FAILURE_INTERVAL)
        self.senders = Senders(node)
        self.subscriptions: dict[str, Subscription] = {}
        for name, command in engine.commands.items():
            if command.direction is not Direction.COMMANDED:
                continue
            profile, kind = qos.of_command(command), TYPES[command.payload]
            subscription = qos.subscription(node, kind, name, _unread, profile)
            receive = self._guarded(name, self._handler(name, command))
            AttributedSubscription(node, subscription, receive, self.senders)
            self.subscriptions[name] = subscription
        for name, taken in engine.inputs.items():
            receive = self._guarded(name, self._taking(name))
            self.subscriptions[name] = qos.subscription(
                node, TYPES[taken.payload], name, receive, qos.NEWEST
            )

    def _taking(self, name: str) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            self._admit(name)
            self._engine.give(name, self._value(name, message))

        return take

    def _handler(self, name: str, command: Command) -> Callable[[Any, Sender], None]:
        if command.payload is Payload.TEXT:
            return self._state_command
        if command.payload is Payload.EMPTY:
            return lambda message, sender: self._submit(name, sender)
        return lambda message, sender: self._submit_value(name, message, sender)

    def _state_command(self, message: Any, sender: Sender) -> None:
        self._admit("state_command", message.string)
        self._engine.state_command(message.string, stamp_ns(message.header.stamp))

    def _submit(self, name: str, sender: Sender) -> None:
        self._admit(name)
        self._engine.submit(name, client=sender)

    def _submit_value(self, name: str, message: Any, sender: Sender) -> None:
        self._admit(name)
        header = getattr(message, "header", None)
        stamp = 0 if header is None else stamp_ns(header.stamp)
        self._engine.submit(name, self._value(name, message, stamp), stamp, sender)

    def _value(self, name: str, message: Any, stamp: int = 0) -> Value:
        header = getattr(message, "header", None)
        frame_id = "" if header is None else self._frames.incoming(header.frame_id)
        try:
            return value_of(message, frame_id)
        except ValueError as error:
            refusal = CommandRefused(
                name,
                Reason.WRONG_SIZE,
                str(error),
                where=self._engine.where,
                remedy="Let each vector be empty, or as long as the others.",
                stamp_ns=stamp,
            )
            self._engine.report_refusal(refusal)
            raise refusal from error

    def _guarded(self, name: str, handle: Callable[..., None]) -> Callable[..., None]:
        def receive(*message: Any) -> None:
            try:
                handle(*message)
            except CommandRefused:
                pass  # the engine has counted it and told its observers
            except Exception:
                if self._failures.passes(name, time.monotonic()):
                    logger.exception("%s: %s failed", self._engine.where, name)

        return receive


def _unread(message: Any) -> None:
    """The callback of a subscription that an `AttributedSubscription` reads."""
