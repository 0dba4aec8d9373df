"""A transport and a decoder together: messages in, bytes out."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from crtk_drivers.errors import ProtocolError
from crtk_drivers.kit.decoding import BadData, Decoder
from crtk_drivers.kit.transport import Transport

__all__ = ["MessageLink"]

Message = TypeVar("Message")

_PATIENCE: Final = 50.0
_FLOOD: Final = 0.05
"""Seconds in which all that has come can be read: what comes still is coming now."""


class MessageLink(Generic[Message]):
    """The messages of one device. It can be opened again and again, each time with a new decoder.

    Args:
        transport: the way to the device.
        make_decoder: makes what turns its bytes into messages.
        remedy: what to do when it sends what its protocol does not allow.
    """

    def __init__(
        self,
        transport: Transport,
        make_decoder: Callable[[], Decoder[Message]],
        remedy: str = "Is this the right device, and the right port?",
    ) -> None:
        self._transport = transport
        self._make_decoder = make_decoder
        self._remedy = remedy
        self._decoder = make_decoder()

    @property
    def where(self) -> str:
        """For messages."""
        return self._transport.where

    def open(self, deadline: float) -> None:
        """Connect, anew if it is connected.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`.
        """
        self._decoder = self._make_decoder()
        self._transport.open(deadline)

    def close(self) -> None:
        """Disconnect. May be called twice."""
        self._transport.close()

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            ConnectionLost: the connection is gone, or takes no more.
        """
        self._transport.write(data)

    def read(self, deadline: float) -> list[Message]:
        """Return what has arrived, oldest first, as soon as there is a message; none by the deadline: [].

        Raises:
            ConnectionLost: the connection is gone.
            ProtocolError: what arrived is no message.
        """
        while data := self._transport.read(deadline):
            try:
                messages = self._decoder.feed(data)
            except BadData as error:
                raise ProtocolError(
                    f"it sent {error}", where=self.where, remedy=self._remedy
                ) from error
            if messages or time.monotonic() >= deadline:
                return messages  # what goes on coming, and is no message, is waited for no longer
        return []

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
        self._decoder = self._make_decoder()
