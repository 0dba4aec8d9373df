"""The control socket of a simulator, in a hub's loop."""

from __future__ import annotations

import socket
import time
from typing import TYPE_CHECKING, Final

from crtk_sim_backends.can.loop import READ, WRITE
from crtk_sim_backends.control import ControlSession, Handlers, token
from crtk_sim_backends.wire import Connection

if TYPE_CHECKING:
    from crtk_sim_backends.can.loop import Loop

_BACKLOG_LIMIT: Final = 1 << 26
_CLIENTS: Final = 64


class _Client:
    """One connection."""

    def __init__(self, door: ControlDoor, loop: Loop, sock: socket.socket, handlers: Handlers):
        self._door = door
        self._loop = loop
        self._session = ControlSession(handlers, door.secret)
        self._connection = Connection(sock, _BACKLOG_LIMIT)
        self._fd = sock.fileno()
        loop.watch(self._fd, self._ready)

    def _ready(self, events: int) -> None:
        now = time.monotonic()
        connection = self._connection
        if events & WRITE:
            connection.flush(now)
        if events & READ:
            connection.read(now)
            for piece in connection.take(now):
                connection.send(self._session.receive(piece), now)
        if connection.ended or self._session.ended:
            self._door.drop(self)
        else:
            self._loop.watch(self._fd, self._ready, READ | WRITE if connection.blocked else READ)

    def close(self) -> None:
        self._loop.forget(self._fd)
        self._connection.close()


class ControlDoor:
    """Serves the control socket `listener`, which it closes at the end."""

    def __init__(self, loop: Loop, listener: socket.socket, handlers: Handlers) -> None:
        self.secret = token()
        self._loop = loop
        self._listener = listener
        self._handlers = handlers
        self._clients: list[_Client] = []
        loop.watch(listener.fileno(), self._accept)

    def _accept(self, events: int) -> None:
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return  # gone before it was accepted
        if len(self._clients) >= _CLIENTS:
            sock.close()
            return
        self._clients.append(_Client(self, self._loop, sock, self._handlers))

    def drop(self, client: _Client) -> None:
        """Let go of a client that has gone."""
        self._clients.remove(client)
        client.close()

    def close(self) -> None:
        """Close the socket and its connections; safe to repeat."""
        for client in self._clients:
            client.close()
        self._clients.clear()
        if self._listener.fileno() >= 0:
            self._loop.forget(self._listener.fileno())
            self._listener.close()
