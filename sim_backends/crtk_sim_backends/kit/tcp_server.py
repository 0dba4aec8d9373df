"""A TCP port in a loop: lets clients in, hands what they send to their sessions, sends the answers."""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Callable
from typing import Final

from crtk_sim_backends.control import ControlSession, Handlers, token
from crtk_sim_backends.faults import Fault
from crtk_sim_backends.kit.loop import READ, WRITE, Loop
from crtk_sim_backends.kit.ports import Client, Port, Session
from crtk_sim_backends.wire import Connection

_BACKLOG_LIMIT: Final = 1 << 26  # bytes that a client does not take, which end its connection
_CLIENTS: Final = 64
_DELAYED: Final = 0.001  # s between looks at data that a fault of the wire holds back

log = logging.getLogger(__name__)


class TcpServer:
    """One listening port and its clients.

    Args:
        loop: in which it lives.
        listener: listening socket, which it closes.
        name: of the port.
        session: makes that of a new client.
        most: clients at a time; more are sent away.
    """

    def __init__(
        self,
        loop: Loop,
        listener: socket.socket,
        name: str,
        session: Callable[[], Session],
        most: int = _CLIENTS,
    ) -> None:
        self._loop = loop
        self._port = Port[Session](name, listener)
        self._session = session
        self._most = most
        self._held: set[Client[Session]] = set()
        self._watch()

    @property
    def number(self) -> int:
        """Of the port."""
        return int(self._port.number)

    @property
    def clients(self) -> int:
        """How many there are."""
        return len(self._port.clients)

    def send(self, data: bytes, to: Session | None = None) -> None:
        """Send to every client that takes it, or to that of a session.

        One that has not taken the last loses this.
        """
        now = time.monotonic()
        for client in list(self._port.clients):
            if to is not None and client.session is not to:
                continue
            if not self._port.silent and client.session is not None:
                client.connection.send_fresh(data, now)
                self._serve(client, now)

    def begin(self, fault: Fault) -> None:
        """Let a fault of the wire begin."""
        self._forget()
        self._port.begin(fault)
        self._watch()

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._forget()
        self._port.end(fault.kind)
        self._watch()

    def close(self) -> None:
        """Close the port and its connections; safe to repeat."""
        self._forget()
        self._port.close()

    def _fds(self) -> list[int]:
        listener = [] if self._port.listener is None else [self._port.listener.fileno()]
        return [*listener, *(client.connection.fileno() for client in self._port.clients)]

    def _forget(self) -> None:
        for fd in self._fds():
            self._loop.forget(fd)

    def _watch(self) -> None:
        if self._port.silent:
            return
        if self._port.listener is not None:
            self._loop.watch(self._port.listener.fileno(), self._accept)
        for client in list(self._port.clients):
            self._serve(client, time.monotonic())

    def _accept(self, events: int) -> None:
        assert self._port.listener is not None
        try:
            peer, _ = self._port.listener.accept()
        except OSError:
            return  # gone before it was accepted
        if self.clients >= self._most or "disconnect" in self._port.faults:
            peer.close()
            return
        try:
            connection = Connection(peer, _BACKLOG_LIMIT)
        except OSError as error:
            log.info("a client of the %s port was gone at once: %s", self._port.name, error)
            peer.close()
            return
        client = Client(connection, self._session() if self._port.answers else None)
        self._port.add(client)
        self._serve(client, time.monotonic())

    def _ready(self, client: Client[Session]) -> None:
        now = time.monotonic()
        client.connection.read(now)
        self._serve(client, now)

    def _serve(self, client: Client[Session], now: float) -> None:
        """Take what has arrived, answer, and wait for more."""
        if client not in self._port.clients or self._port.silent:
            return
        connection = client.connection
        try:
            for piece in connection.take(now):
                connection.send(client.receive(piece), now)
        except Exception:
            log.exception("a defect of the simulator closes a %s connection", self._port.name)
            connection.closed = True
        if client.ended:
            connection.flush(now)  # its last words
        if connection.ended or client.ended:
            self._loop.forget(connection.fileno())
            self._port.remove(client)
            return
        connection.flush(now)
        events = READ | WRITE if connection.blocked else READ
        self._loop.watch(connection.fileno(), lambda _: self._ready(client), events)
        waits = connection.has_input or (connection.has_output and not connection.blocked)
        if waits and client not in self._held:
            self._held.add(client)
            self._loop.call_at(now + _DELAYED, lambda: self._look_again(client))

    def _look_again(self, client: Client[Session]) -> None:
        self._held.discard(client)
        self._serve(client, time.monotonic())


def control_door(loop: Loop, listener: socket.socket, handlers: Handlers) -> TcpServer:
    """Return the control socket of a simulator; see :mod:`crtk_sim_backends.control`."""
    secret = token()
    return TcpServer(loop, listener, "control", lambda: ControlSession(handlers, secret))
