"""A UDP port in a loop: who has sent last is its client, and what is sent goes there."""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable
from typing import Final

from crtk_sim_backends.faults import Fault
from crtk_sim_backends.kit.faulty_line import FaultyLine
from crtk_sim_backends.kit.loop import Loop
from crtk_sim_backends.kit.ports import Session
from crtk_sim_backends.process import bind_udp
from crtk_sim_backends.wire import Direction

_LONGEST: Final = 65536

log = logging.getLogger(__name__)


class UdpServer:
    """One UDP port. A new client has a new session; each datagram is a piece of data of its own.

    Args:
        loop: in which it lives.
        bound: its socket, which it closes.
        name: of the port.
        session: makes that of a new client.
    """

    def __init__(
        self, loop: Loop, bound: socket.socket, name: str, session: Callable[[], Session]
    ) -> None:
        self._loop = loop
        self._socket: socket.socket | None = bound
        self.host, self.number = bound.getsockname()
        self._name = name
        self._make_session = session
        self._session: Session | None = None
        self._client: tuple[str, int] | None = None
        self._line = FaultyLine(loop, self._take, self._transmit, joins=False)
        self._loop.watch(bound.fileno(), self._receive)

    @property
    def clients(self) -> int:
        """Whether there is one, 1 or 0."""
        return self._client is not None

    def send(self, data: bytes, to: Session | None = None) -> None:
        """Send a datagram to the client, if there is one. It has one session."""
        if self._session is not None:
            self._line.carry(Direction.OUT, data)

    def begin(self, fault: Fault) -> None:
        """Let a fault of the wire begin; by ``disconnect`` nobody is at the port, and the client is gone."""
        if fault.kind == "disconnect":
            self.close()
        else:
            self._line.begin(fault)

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if fault.kind == "disconnect" and self._socket is None:
            self._socket = bind_udp(self.host, self.number, self._name)
            self._loop.watch(self._socket.fileno(), self._receive)
        else:
            self._line.end(fault)

    def close(self) -> None:
        """Close the port; safe to repeat."""
        if self._socket is not None:
            self._loop.forget(self._socket.fileno())
            self._socket.close()
            self._socket = None
        self._forget_client()

    def _forget_client(self) -> None:
        if self._session is not None:
            self._session.close()
        self._session = self._client = None
        self._line.clear()

    def _receive(self, events: int) -> None:
        assert self._socket is not None
        try:
            data, sender = self._socket.recvfrom(_LONGEST)
        except OSError as error:  # that of an earlier datagram, which found nobody
            log.debug("%s: %s", self._name, error)
            return
        if sender != self._client:
            self._forget_client()
            self._client = sender
            self._session = self._make_session() if self._line.answers else None
        self._line.carry(Direction.IN, data)

    def _take(self, data: bytes) -> None:
        if self._session is not None:
            self.send(self._session.receive(data))

    def _transmit(self, data: bytes) -> None:
        if self._socket is None or self._client is None:
            return
        try:
            self._socket.sendto(data, self._client)
        except OSError as error:
            log.debug("%s: a datagram was not sent: %s", self._name, error)
