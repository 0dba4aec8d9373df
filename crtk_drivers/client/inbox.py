"""What a client hears: the bytes of the newest message of a topic, read when somebody asks for what they say.

A topic that is heard at 500 Hz and read at 10 Hz costs ten readings a second. Bytes that are no message of
their type are told, counted and passed over, as if they had not been sent; no callback raises.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

from rclpy.serialization import deserialize_message

from crtk_drivers.commands import Payload
from crtk_drivers.errors import CrtkError
from crtk_drivers.recording import cdr
from crtk_drivers.ros.manifest import type_name
from crtk_drivers.ros.messages import TYPES
from crtk_drivers.samples import Text, Value
from crtk_drivers.state import Status
from crtk_drivers.status.throttle import Throttle

logger = logging.getLogger(__name__)

UNREADABLE_INTERVAL: Final = 2.0
"""Seconds between two warnings of messages on a topic that cannot be read."""


class Unreadable(ValueError):
    """Bytes that are no message of the topic's type."""


class _InCallback(threading.local):
    active = False


_in_callback = _InCallback()


def may_wait(what: str) -> None:
    """Make sure that this thread may wait for a message.

    Raises:
        CrtkError: it is delivering one, so that no other could arrive.
    """
    if _in_callback.active:
        raise CrtkError(
            f"{what} would wait inside a callback, and nothing arrives before that returns",
            remedy="Set a flag or an event in the callback, and do the rest in your own thread.",
        )


@dataclass
class Received:
    """One message.

    `data` are its bytes, `kind` is its ROS class. `wall_ns` is its stamp, 0 for what is not valid. `since` is
    when (monotonic, s) the first message with this stamp arrived: the age of a value that is sent again and
    again grows, whatever the clocks say. `arrived` is when this one did.
    """

    data: bytes
    kind: type
    wall_ns: int
    since: float
    serial: int
    arrived: float

    @cached_property
    def value(self) -> Value:
        """What it says.

        Raises:
            Unreadable: no value of its type.
        """
        found: Value = self._read()
        return found

    @property
    def text(self) -> str:
        """What a text says. Raises as `value` does."""
        value = self.value
        assert isinstance(value, Text)
        return value.value

    @cached_property
    def status(self) -> Status:
        """What an operating state says.

        Raises:
            Unreadable: no operating state.
        """
        found: Status = self._read()
        return found

    def _read(self) -> Any:
        try:
            if self.kind is TYPES[Payload.MATRIX]:
                return cdr.decode_matrix(self.data)
            return cdr.decode(type_name(self.kind), self.data).value
        except ValueError as error:
            raise Unreadable(str(error)) from error

    @cached_property
    def message(self) -> Any:
        """It as a ROS object, of whatever type.

        Raises:
            Unreadable: no message of its type.
        """
        try:
            return deserialize_message(self.data, self.kind)
        except Exception as error:  # what it raises depends on the middleware
            raise Unreadable(f"this is no {type_name(self.kind)}: {error}") from error


class Inbox:
    """The newest message of one topic. Made by `Link`.

    Args:
        topic: full name.
        kind: ROS class of its messages.
        latched: whether what was said before a subscription arrives with it.

    Attributes:
        latest: the newest message.
        valid: the newest message with a stamp; the stamp 0 marks what is not valid.
        unreadable: how many messages could not be read.
        problem: why the newest message cannot be read; empty if it can, or was not read yet.
    """

    was_connected = False

    def __init__(self, topic: str, kind: Any, latched: bool = False) -> None:
        self.topic = topic
        self.kind = kind
        self.latched = latched
        self.latest: Received | None = None
        self.valid: Received | None = None
        self.subscription: Any = None
        self.unreadable = 0
        self.problem = ""
        fields: dict[str, str] = kind.get_fields_and_field_types()
        self._has_header = next(iter(fields.items()), None) == ("header", "std_msgs/Header")
        self._warnings = Throttle(UNREADABLE_INTERVAL)
        self._passed_over: Received | None = None
        self._arrived = threading.Condition()
        self._listeners: tuple[Callable[[Received], None], ...] = ()

    def add_listener(self, listener: Callable[[Received], None]) -> None:
        """Call `listener` with each message, from the thread that spins.

        What is latched and arrived before is told here and now: the newest, and never after a newer one.
        """
        told = None
        while True:
            with self._arrived:
                said = self.latest if self.latched else None
                if said is None or said is told:
                    self._listeners = (*self._listeners, listener)
                    return
            self._tell((listener,), said)
            told = said

    def remove_listener(self, listener: Callable[[Received], None]) -> None:
        """Call `listener` no more."""
        with self._arrived:
            self._listeners = tuple(other for other in self._listeners if other != listener)

    def receive(self, data: bytes) -> None:
        """The bytes of a message arrived."""
        now = time.monotonic()
        try:
            wall_ns = cdr.stamp_of(data) if self._has_header else time.time_ns()
        except cdr.Malformed as error:
            self._pass_over(error)
            return
        with self._arrived:
            last = self.latest
            serial = 1 if last is None else last.serial + 1
            since = last.since if last is not None and wall_ns == last.wall_ns else now
            self.latest = received = Received(data, self.kind, wall_ns, since, serial, now)
            if wall_ns:
                self.valid = received
            self.problem = ""
            listeners = self._listeners
            self._arrived.notify_all()
        self._tell(listeners, received)

    def _tell(self, listeners: tuple[Callable[[Received], None], ...], received: Received) -> None:
        within, _in_callback.active = _in_callback.active, True
        try:
            for listener in listeners:
                try:
                    listener(received)
                except Unreadable as error:
                    self._pass_over(error, received)
                except Exception:
                    logger.exception("a callback for %s failed", self.topic)
        finally:
            _in_callback.active = within

    def _pass_over(self, error: ValueError, received: Received | None = None) -> None:
        if received is None or received is not self._passed_over:
            self.unreadable += 1
        self._passed_over = received
        self.problem = str(error)
        if self._warnings.passes(self.topic, time.monotonic()):
            logger.warning("a message on %s cannot be read: %s", self.topic, error)

    def readable(self) -> Received | None:
        """Return the newest message that is valid; None if there is none, or if it has no value."""
        valid = self.valid
        return valid if valid is not None and self._can_read(valid) else None

    def _can_read(self, received: Received) -> bool:
        try:
            received.value  # noqa: B018 - it is made when it is asked for
        except Unreadable as error:
            self._pass_over(error, received)
            return False
        return True

    def wait_for(self, accept: Callable[[Received], bool], timeout: float) -> Received | None:
        """Return the newest message once it has a value and `accept` likes it, None if not in time."""

        def accepted() -> Received | None:
            latest = self.latest
            return (
                latest if latest is not None and accept(latest) and self._can_read(latest) else None
            )

        found = accepted()
        if found is not None or timeout <= 0.0:
            return found
        may_wait(f"reading {self.topic}")
        with self._arrived:
            return self._arrived.wait_for(accepted, timeout)

    @property
    def connected(self) -> bool:
        """Whether somebody publishes."""
        return bool(self.publishers)

    @property
    def publishers(self) -> int:
        """How many publish."""
        return int(self.subscription.get_publisher_count())
