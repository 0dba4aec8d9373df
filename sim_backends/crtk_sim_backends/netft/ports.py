"""One listening TCP port of the box: its clients, and the faults of its wire."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from typing import Protocol

from crtk_sim_backends import wire
from crtk_sim_backends.control import ControlSession
from crtk_sim_backends.faults import Fault
from crtk_sim_backends.netft.injection import WIRE
from crtk_sim_backends.process import listen


class Session(Protocol):
    """One client of a port: bytes in, bytes out. `ended` asks for the connection to be closed."""

    ended: bool

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return what to send."""

    def more(self, now: float) -> bytes:
        """Return what comes by itself."""

    def close(self) -> None:
        """Let go of everything: the client is gone."""


class Mute:
    """Reads and never answers."""

    ended = False

    def receive(self, data: bytes) -> bytes:
        """Take received bytes."""
        return b""

    def more(self, now: float) -> bytes:
        """Nothing comes by itself."""
        return b""

    def close(self) -> None:
        """Do nothing."""


class Requests(ControlSession):
    """A connection of the control port."""

    def more(self, now: float) -> bytes:
        """Nothing comes by itself."""
        return b""


@dataclass(eq=False)
class Client:
    """One accepted connection."""

    connection: wire.Connection
    session: Session


class Port:
    """One listening port.

    Args:
        name: of the port.
        listener: listening socket.
    """

    def __init__(self, name: str, listener: socket.socket) -> None:
        self.name = name
        self.host, self.number = listener.getsockname()
        self.listener: socket.socket | None = listener
        self.clients: list[Client] = []
        self.faults: dict[str, Fault] = {}
        self._hooks: dict[str, wire.WireHook] = {}

    @property
    def silent(self) -> bool:
        """Whether nothing may be read, sent or accepted."""
        return "silence" in self.faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        self.faults[fault.kind] = fault
        if fault.kind in WIRE:
            self._hooks[fault.kind] = WIRE[fault.kind](fault.parameters)
            self._apply_hooks()
        if fault.kind in ("closed", "disconnect"):
            self.disconnect()
        if fault.kind == "closed":
            self.close()

    def end(self, kind: str) -> None:
        """Let it end."""
        self.faults.pop(kind, None)
        if self._hooks.pop(kind, None) is not None:
            self._apply_hooks()
        if kind == "closed" and self.listener is None:
            self.listener = listen(self.host, self.number, self.name)

    def add(self, client: Client) -> None:
        """Take a new client, with the present faults of the wire."""
        client.connection.hook = wire.chain(self._hooks.values())
        self.clients.append(client)

    def remove(self, client: Client) -> None:
        """Close the connection of a client."""
        self.clients.remove(client)
        client.connection.close()
        client.session.close()

    def disconnect(self) -> None:
        """Close all connections."""
        for client in list(self.clients):
            self.remove(client)

    def close(self) -> None:
        """Close everything."""
        self.disconnect()
        if self.listener is not None:
            self.listener.close()
            self.listener = None

    def _apply_hooks(self) -> None:
        hook = wire.chain(self._hooks.values())
        for client in self.clients:
            client.connection.hook = hook
