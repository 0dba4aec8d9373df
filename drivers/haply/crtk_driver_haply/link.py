"""The way to Haply's Inverse service: texts over a WebSocket (RFC 6455).

The library `websockets` makes and reads the frames; bytes go by the kit's TCP transport, so that each wait
has a deadline and no thread is needed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from websockets.client import ClientProtocol
from websockets.frames import Close, CloseCode, Frame, Opcode
from websockets.http11 import Response
from websockets.protocol import State
from websockets.uri import parse_uri

from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit import ClosedByPeer, TcpTransport

__all__ = ["ServiceLink"]

LARGEST: Final = 1 << 18
"""Bytes of a message; more is none of a few devices."""
ANSWERS: Final = 0.1
"""Seconds after which a message that was not answered is not waited for: its answer comes late, or never."""
NEVER: Final = 1.0
"""Seconds after which an answer that was late will not come."""
_GOODBYE: Final = Close(CloseCode.NORMAL_CLOSURE, "").serialize()
_REMEDY: Final = "Does the Inverse service run (Haply Hub), and is this its port?"


class ServiceLink:
    """One connection, which can be opened again and again.

    Args:
        host: of the service.
        port: of its simulation channel.
        aborted: asked while something is waited for: whether to give up.
    """

    def __init__(self, host: str, port: int, aborted: Callable[[], bool]) -> None:
        self._tcp = TcpTransport(host, port, "haply", _REMEDY, aborted=aborted)
        self._uri = parse_uri(f"ws://{host}:{port}")
        self._protocol = ClientProtocol(self._uri, max_size=LARGEST)
        self._begun = bytearray()
        self._owed = 0
        self._sent_at = self._missed_at = 0.0
        self.sent = self.answered = 0
        """Messages of this connection, and how many of them, the oldest ones, have been answered for sure."""

    @property
    def where(self) -> str:
        """For messages."""
        return self._tcp.where

    @property
    def may_send(self) -> bool:
        """Whether no answer is on its way: a service that is asked faster than it answers falls behind."""
        return self._owed <= 0 or time.monotonic() - self._sent_at > ANSWERS

    def open(self, deadline: float) -> list[bytes]:
        """Connect, anew if it is connected; return the texts that came with the answer.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`, or what answers speaks no WebSocket.
        """
        self._begun.clear()
        self._owed = self.sent = self.answered = 0
        self._protocol = protocol = ClientProtocol(self._uri, max_size=LARGEST)
        self._tcp.open(deadline)
        protocol.send_request(protocol.connect())
        texts: list[bytes] = []
        try:
            self._flush()
            while protocol.state is State.CONNECTING and protocol.handshake_exc is None:
                data = self._tcp.read(deadline)
                if not data and time.monotonic() >= deadline:
                    raise self._failed("it does not answer the handshake")
                texts += self._take(data)
        except ClosedByPeer:
            protocol.receive_eof()
        except ConnectionLost as error:
            raise self._failed(error.message) from error
        if protocol.handshake_exc is not None:
            raise self._failed(f"it speaks no WebSocket: {protocol.handshake_exc}")
        return texts

    def close(self) -> None:
        """Disconnect, with a goodbye. May be called twice."""
        if self._tcp.is_open and self._protocol.state is State.OPEN:
            with suppress(ConnectionLost):  # it is gone without one, then
                self._tcp.write(Frame(Opcode.CLOSE, _GOODBYE).serialize(mask=True))
        self._tcp.close()

    def send(self, text: bytes) -> None:
        """Send a text, at once. From any thread: a frame goes out as one piece.

        Raises:
            ConnectionLost: the connection is gone, or takes no more.
        """
        if self.may_send:
            self._count_missing(time.monotonic())
        self._tcp.write(Frame(Opcode.TEXT, text).serialize(mask=True))
        self.sent += 1
        self._owed += 1
        self._sent_at = time.monotonic()

    def _count_missing(self, now: float) -> None:
        """Wait no longer for an answer; take it as given where it is missing since long."""
        if self._owed:
            self._missed_at = now
        elif now - self._missed_at > NEVER:
            self.answered = self.sent
        self._owed = 0

    def receive(self, deadline: float) -> list[bytes]:
        """Return the texts that have come, oldest first, as soon as there is one; none by the deadline: [].

        Raises:
            ConnectionLost: the connection is gone, or what came is no WebSocket.
        """
        while data := self._tcp.read(deadline):
            if (texts := self._take(data)) or time.monotonic() >= deadline:
                return texts
        return []

    def _take(self, data: bytes) -> list[bytes]:
        """Return the texts that bytes complete; answer pings, and a goodbye."""
        protocol = self._protocol
        was_open = protocol.state is State.OPEN
        protocol.receive_data(data)
        texts: list[bytes] = []
        for event in protocol.events_received():
            if isinstance(event, Response):
                was_open = protocol.state is State.OPEN
                continue
            if not isinstance(event, Frame) or event.opcode not in (Opcode.TEXT, Opcode.CONT):
                continue
            self._begun += event.data
            if len(self._begun) > LARGEST:
                raise self._lost(f"a message of more than {LARGEST} bytes came")
            if event.fin:
                texts.append(bytes(self._begun))
                self._begun.clear()
        self._owed -= min(self._owed, len(texts))
        self.answered = min(self.answered + len(texts), self.sent)
        self._flush()
        if was_open and protocol.state is not State.OPEN:
            raise self._lost(f"the service ended it: {protocol.parser_exc or protocol.close_rcvd}")
        return texts

    def _flush(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._tcp.write(data)

    def _lost(self, what: str) -> ConnectionLost:
        return ConnectionLost(what, where=self.where, remedy=_REMEDY)

    def _failed(self, what: str) -> ConnectionFailed:
        self.close()
        return ConnectionFailed(what, where=self.where, remedy=_REMEDY)
