"""Subscriptions: one for each command and input that the device offers, and for none besides.

A message is read from its bytes, and no ROS object is made of it. A callback reads, hands over to the
engine, which checks everything, and returns; it never waits and touches no bus. What is refused is counted
and told by the engine; nothing raises into the thread that reads.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from crtk_drivers.commands import ROS_TYPES, Command, Direction, Payload, find
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.options import TOO_LATE
from crtk_drivers.recording import cdr
from crtk_drivers.ros import qos
from crtk_drivers.ros.arrival import Arrival
from crtk_drivers.ros.command_threads import CommandThreads, HeardTopic
from crtk_drivers.ros.messages import TYPES
from crtk_drivers.ros.names import Frames
from crtk_drivers.ros.received import Received
from crtk_drivers.ros.senders import Senders
from crtk_drivers.ros.unlocked import UnlockedNode
from crtk_drivers.samples import CartesianServo, Pose, Text, Twist, Value, Wrench
from crtk_drivers.state import REPEATED, STOPS, StateCommand, Status
from crtk_drivers.status.throttle import Throttle

logger = logging.getLogger(__name__)

FAILURE_INTERVAL = 2.0

_MOVING = frozenset({StateCommand.HOME, StateCommand.UNHOME})


class CommandTopics:
    """The subscriptions of one device.

    Args:
        node: of the driver.
        engine: of the device.
        frames: names of its frames.
        admit: called with each command, and what it says if it is a state command; may refuse it.
        threads: read them.

    Attributes:
        senders: of what arrived on them.
    """

    def __init__(
        self,
        node: UnlockedNode,
        engine: Engine,
        frames: Frames,
        admit: Callable[..., None],
        threads: CommandThreads,
    ) -> None:
        self._node = node
        self._threads = threads
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
            self.subscriptions[name] = self.listen(
                name, kind, self._handler(name, command), profile
            )
        for name, taken in engine.inputs.items():
            self.subscriptions[name] = self.listen(
                name, TYPES[taken.payload], self._taking(name, taken.payload), qos.NEWEST
            )

    def listen(
        self, topic: str, kind: Any, handle: Callable[[Received], None], profile: QoSProfile
    ) -> Subscription:
        """Hand each message on a topic to `handle`, from one of the threads that read commands."""
        subscription = qos.subscription(self._node, kind, topic, _unread, profile)
        receive = self._guarded(topic, handle)
        heard = HeardTopic(self._node, subscription, receive, self.senders)
        self._threads.add(heard, stops=topic in qos.STOPPING)
        return subscription

    def _taking(self, name: str, payload: Payload) -> Callable[[Received], None]:
        def take(message: Received) -> None:
            self._admit(name)
            self._engine.give(name, self.read(name, payload, message.data)[0])

        return take

    def _handler(self, name: str, command: Command) -> Callable[[Received], None]:
        payload = command.payload
        if payload is Payload.TEXT:
            return self._state_command
        if payload is Payload.EMPTY:
            return lambda message: self._submit_empty(name, message)
        if command.is_relative:
            return lambda message: self._submit_increment(name, payload, message)
        return lambda message: self._submit_value(name, payload, message)

    def _state_command(self, message: Received) -> None:
        text, stamp, is_repeated = self._text_of(message.data)
        self._admit("state_command", text)
        arrival = message.ordered
        message.sender.clock.changes_state(arrival)
        may_move = text in _MOVING or self._engine.capabilities.enable_moves
        sent_ns = arrival.earliest_ns if may_move else arrival.sent_ns
        self._engine.state_command(
            text, stamp, arrival.received_ns, sent_ns, is_repeated=is_repeated
        )

    def _text_of(self, data: bytes) -> tuple[str, int, bool]:
        """Return what a state command says, its stamp, and whether it says that it is sent again.

        A stop is not refused for what stands before or behind it: of a message that cannot be read, the
        stop that it names last counts.
        """
        try:
            found = cdr.decode(ROS_TYPES[Payload.TEXT], data, is_exact=False)
        except ValueError as error:
            stop = cdr.last_word_of(data, STOPS)
            if not stop:
                raise self._unreadable("state_command", data, error) from error
            if self._failures.passes(stop, time.monotonic()):
                text = "%s: a state_command that cannot be read says %s, which is carried out: %s"
                logger.warning(text, self._engine.where, stop, error)
            return stop, 0, False
        assert isinstance(found.value, Text)
        return found.value.value, found.stamp_ns, found.frame_id == REPEATED

    def submit(self, name: str, value: Value | None, stamp_ns: int, message: Received) -> None:
        """Hand a command to the engine: a stop as of when it came, anything else as of when it was sent.

        Raises:
            CommandRefused: by the engine; or it belongs to a stream, and comes too late for that.
        """
        arrival, sender = message.ordered, message.sender
        if name == "hold":
            sender.clock.changes_state(arrival)
            self._engine.submit(name, value, stamp_ns, sender, arrival.received_ns)
            return
        self._require_in_time(name, stamp_ns, message.arrival)
        self._engine.submit(name, value, stamp_ns, sender, arrival.earliest_ns)

    def _require_in_time(self, name: str, stamp_ns: int, arrival: Arrival) -> None:
        """Refuse a command of a stream that DDS has repeated after seconds: it has been over for long."""
        command = find(name)
        if not command.is_stream:
            return
        limit = max(TOO_LATE, self._engine.options.silence(command.level))
        if arrival.late > limit:
            refusal = CommandRefused(
                name,
                Reason.TOO_OLD,
                f"it came {arrival.late:.1f} s later than others of its sender; of a stream, {limit:g} s is "
                "the limit",
                where=self._engine.where,
                remedy="The network has lost it, or kept it: look where the device is before you go on.",
                stamp_ns=stamp_ns,
            )
            self._engine.report_refusal(refusal)
            raise refusal

    def _submit_empty(self, name: str, message: Received) -> None:
        self._admit(name)
        self.submit(name, None, 0, message)

    def _submit_value(self, name: str, payload: Payload, message: Received) -> None:
        self._admit(name)
        value, stamp = self.read(name, payload, message.data)
        self.submit(name, value, stamp, message)

    def _submit_increment(self, name: str, payload: Payload, message: Received) -> None:
        """Carry one out, and tell of those before it that were lost: each of them is motion."""
        if message.lost:
            self._engine.report_refusal(
                CommandRefused(
                    name,
                    Reason.LOST,
                    f"{message.lost} of {message.sender.name} came and were dropped, unread",
                    where=self._engine.where,
                    remedy="Send fewer: the driver keeps 200 of them until it reads them. "
                    "Look where the device is before you go on.",
                )
            )
        self._submit_value(name, payload, message)

    def read(self, name: str, payload: Payload, data: bytes) -> tuple[Value, int]:
        """Return the value of a message, in the device's own frame, and its stamp."""
        try:
            found = cdr.decode(ROS_TYPES[payload], data)
        except ValueError as error:
            raise self._unreadable(name, data, error) from error
        value = found.value
        assert not isinstance(value, Status)  # no command and no input is one
        if isinstance(value, Pose | Twist | Wrench | CartesianServo):
            value = replace(value, frame_id=self._frames.incoming(value.frame_id))
        return value, found.stamp_ns

    def _unreadable(self, name: str, data: bytes, error: ValueError) -> CommandRefused:
        """Return the refusal of a message that cannot be read, which is counted."""
        refusal = _refused(name, data, error, self._engine.where)
        self._engine.report_refusal(refusal)
        return refusal

    def _guarded(self, name: str, handle: Callable[[Received], None]) -> Callable[[Received], None]:
        """Return `handle` such that it raises nothing into the thread that reads."""

        def receive(message: Received) -> None:
            try:
                handle(message)
            except CommandRefused:
                pass  # the engine has counted it and told its observers
            except Exception:
                if self._failures.passes(name, time.monotonic()):
                    logger.exception("%s: %s failed", self._engine.where, name)

        return receive


def _refused(name: str, data: bytes, error: ValueError, where: str) -> CommandRefused:
    if isinstance(error, cdr.Malformed):
        remedy = (
            "Does its publisher have the same definition of the type? A bag or a bridge may not."
        )
        return CommandRefused(name, Reason.WRONG_TYPE, str(error), where=where, remedy=remedy)
    remedy = "Let each vector be empty, or as long as the others."
    stamp = cdr.stamp_of(data)
    return CommandRefused(
        name, Reason.WRONG_SIZE, str(error), where=where, remedy=remedy, stamp_ns=stamp
    )


def _unread(message: Any) -> None:
    """The callback of a subscription that `CommandThreads` read."""
