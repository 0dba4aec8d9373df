"""A transport and a decoder together: messages in, bytes out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Final, Generic, NoReturn, TypeVar

from crtk_drivers.device import Note, Severity
from crtk_drivers.errors import ConnectionFailed, ProtocolError
from crtk_drivers.kit.decoding import BadData, Damage, Decoder, Tolerant
from crtk_drivers.kit.transport import Transport

__all__ = ["Linked", "MessageLink"]

Message = TypeVar("Message")

DEGRADED_AFTER: Final = 3
"""Damaged records in a row that are told: single ones happen on a long cable."""
LOST_AFTER: Final = 10
"""Damaged records in a row with which a connection counts as lost, where a driver does not say otherwise."""

_PATIENCE: Final = 50.0
_FLOOD: Final = 0.05
"""Seconds in which all that has come can be read: what comes still is coming now."""


class MessageLink(Generic[Message]):
    """The messages of one device. It can be opened again and again, each time with a new decoder.

    A damaged record is left out and counted. Some in a row are told (`notes`); many end the connection.

    A network that passes nothing tells nobody. TCP keeps what is sent meanwhile, and delivers all of it when
    the network is free again, although the driver is in FAULT, has closed the connection or was killed.
    Nothing takes it back: so whoever streams setpoints looks at `unheard`, and sends none while the device
    has not said a word for longer than it ever needs. A stop is sent at any time: it comes last, and ends
    what was sent before it.

    It is the device's word that counts. An acknowledgement of TCP may be 0.2 s late where nothing is
    answered, and a gateway acknowledges what it only keeps. A connection that is reset, or given up by the
    system (TCP_USER_TIMEOUT), drops the stop as well, and stays open at the controller.

    Args:
        transport: the way to the device.
        make_decoder: makes what turns its bytes into messages.
        remedy: what to do when it sends what its protocol does not allow.
        lost_after: damaged records in a row, without a sound one, with which the connection counts as lost.
    """

    def __init__(
        self,
        transport: Transport,
        make_decoder: Callable[[], Decoder[Message]],
        remedy: str = "Is this the right device, and the right port?",
        *,
        lost_after: int = LOST_AFTER,
    ) -> None:
        self._transport = transport
        self._make_decoder = make_decoder
        self._remedy = remedy
        self._lost_after = lost_after
        self._damaged = 0
        self._decoder = make_decoder()
        self._unheard_since = math.inf

    @property
    def where(self) -> str:
        """For messages."""
        return self._transport.where

    def open(self, deadline: float) -> None:
        """Connect, anew if it is connected.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`.
        """
        self._begin_anew()
        self._unheard_since = math.inf
        self._transport.open(deadline)

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self._transport.close()

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            ConnectionLost: the connection is gone, or takes no more.
        """
        self._unheard_since = min(self._unheard_since, time.monotonic())
        self._transport.write(data)

    @property
    def unheard(self) -> float:
        """Seconds since something was sent after which no message came; 0 if one did. From any thread."""
        return max(0.0, time.monotonic() - self._unheard_since)

    def read(self, deadline: float) -> list[Message]:
        """Return what has arrived, oldest first, as soon as there is a message; none by the deadline: [].

        Raises:
            ConnectionLost: the connection is gone.
            ProtocolError: what arrived is no message, and nothing that follows can be one; or many in a row
                were damaged.
        """
        while data := self._transport.read(deadline):
            messages = self._fed(data)
            if messages or time.monotonic() >= deadline:
                return messages  # what goes on coming, and is no message, is waited for no longer
        return []

    def came(self) -> list[Message]:
        """Return what has come by now, without waiting: for who asks, before the next question.

        Such answers came late. Each one that stays would be taken for the answer to a later question, and all
        that is measured would be older than its stamp from then on.

        Raises:
            ConnectionLost, ProtocolError: see `read`.
        """
        messages: list[Message] = []
        end = time.monotonic() + _FLOOD
        while time.monotonic() < end and (data := self._transport.read(0.0)):
            messages += self._fed(data)
        return messages

    def await_message(
        self,
        deadline: float,
        is_wanted: Callable[[Message], bool] = lambda _: True,
        *,
        ask: bytes = b"",
        again: float = 0.5,
    ) -> Message:
        """Return the first message that is wanted, for `Device.open`; others that come before it are dropped.

        Args:
            deadline: monotonic seconds.
            is_wanted: whether a message is the one, and not an acknowledgement or a greeting.
            ask: the question to which it is the answer; empty where it comes by itself.
            again: seconds after which the question is sent again: it or its answer may have been damaged.

        Raises:
            ConnectionFailed: none came by the deadline; it says what came instead.
            ConnectionLost: the connection is gone.
        """
        others, last, damaged = 0, "", self.damaged
        while (now := time.monotonic()) < deadline:
            if ask:
                self.write(ask)
            until = min(deadline, now + again)
            while time.monotonic() < until:
                for message in self.read(until):
                    if is_wanted(message):
                        return message
                    others, last = others + 1, repr(message)
        damaged = self.damaged - damaged
        came = [f"{others} other messages, the last {last}"] if others else []
        came += [f"{damaged} damaged records, the last {self._damage.last}"] if damaged else []
        raise ConnectionFailed(
            f"it does not answer; it sent {' and '.join(came) or 'nothing'}",
            where=self.where,
            remedy=self._remedy,
        )

    def forget(self, quiet: float = 0.0) -> None:
        """Forget what has arrived by now: answers that come late must not be taken for others.

        Args:
            quiet: seconds in which nothing may come any more, for the rest of what was cut off or damaged; it
                is waited for fifty times as long at the most.

        Raises:
            ConnectionLost: the connection is gone.
        """
        end = time.monotonic() + max(_PATIENCE * quiet, _FLOOD)
        while self._transport.read(time.monotonic() + quiet):
            if time.monotonic() > end:
                break
        self._begin_anew()

    @property
    def damaged(self) -> int:
        """How many damaged records were left out, over all connections."""
        return self._damaged + self._damage.total

    @property
    def counters(self) -> Mapping[str, float]:
        """For `Device.counters`."""
        return {"damaged": float(self.damaged)}

    @property
    def notes(self) -> tuple[Note, ...]:
        """For `Device.notes`: that the connection is degraded."""
        damage = self._damage
        if damage.in_a_row < DEGRADED_AFTER:
            return ()
        text = f"{damage.in_a_row} in a row, the last {damage.last}"
        return (Note(Severity.WARNING, "damaged records", text),)

    @property
    def _damage(self) -> Damage:
        return self._decoder.damage if isinstance(self._decoder, Tolerant) else Damage()

    def _fed(self, data: bytes) -> list[Message]:
        try:
            messages = self._decoder.feed(data)
        except BadData as error:
            self._refuse(str(error))
        if messages:
            self._unheard_since = math.inf
        self._judge()
        return messages

    def _begin_anew(self) -> None:
        self._damaged += self._damage.total
        self._decoder = self._make_decoder()

    def _judge(self) -> None:
        damage = self._damage
        if damage.in_a_row >= self._lost_after:
            self._refuse(f"{damage.in_a_row} damaged records in a row, the last {damage.last}")

    def _refuse(self, what: str) -> NoReturn:
        raise ProtocolError(f"it sent {what}", where=self.where, remedy=self._remedy)


class Linked(Generic[Message]):
    """Pass on the counters and notes of `self._link`: of a device or `Hand` that has one `MessageLink`.

    It comes first among the base classes: ``class ScaleDevice(Linked[Weight], Sensor)``.
    """

    _link: MessageLink[Message]

    @property
    def counters(self) -> Mapping[str, float]:
        """How many damaged records were left out."""
        return self._link.counters

    @property
    def notes(self) -> tuple[Note, ...]:
        """That the connection is degraded, if it is."""
        return self._link.notes
