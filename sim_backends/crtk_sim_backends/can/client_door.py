"""A listening socket of the hub, and the clients that have come through it."""

from __future__ import annotations

import socket
from abc import ABC, abstractmethod
from typing import Generic, Protocol, TypeVar

from crtk_sim_backends.can.node import Bus


class Client(Protocol):
    """One that came through the door."""

    def close(self) -> None:
        """Leave the bus and close the connection."""


ClientT = TypeVar("ClientT", bound=Client)


class ClientDoor(ABC, Generic[ClientT]):
    """One door.

    Args:
        hub: whose bus the clients come to.
        listener: that listens.
        most: clients at a time.
    """

    def __init__(self, hub: Bus, listener: socket.socket, most: int) -> None:
        self._hub = hub
        self._clients: list[ClientT] = []
        self._listener = listener
        self._most = most
        hub.loop.watch(listener.fileno(), self._accept)

    @abstractmethod
    def _welcome(self, sock: socket.socket) -> ClientT:
        """Return the client of a new connection."""

    def _accept(self, events: int) -> None:
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return  # gone before it was accepted
        if len(self._clients) >= self._most:
            sock.close()
            return
        self._clients.append(self._welcome(sock))
        self._hub.happened("client_connected")

    def drop(self, client: ClientT) -> None:
        """Let go of a client that has gone."""
        self._clients.remove(client)
        client.close()

    def close(self) -> None:
        """Close it and its connections; safe to repeat."""
        for client in self._clients:
            client.close()
        self._clients.clear()
        if self._listener.fileno() >= 0:
            self._hub.loop.forget(self._listener.fileno())
            self._listener.close()
