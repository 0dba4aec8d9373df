"""One listening port of the simulated controller: its clients, and the faults of its wire."""

from __future__ import annotations

import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from crtk_sim_backends import wire
from crtk_sim_backends.faults import Fault
from crtk_sim_backends.ur.injection import HOOKS


class Session(Protocol):
    """One client of a port: bytes in, bytes out. `ended` asks for the connection to be closed."""

    ended: bool

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return what to send."""

    def close(self) -> None:
        """Let go of everything: the client is gone."""


class Mute:
    """Reads and never answers."""

    ended = False

    def receive(self, data: bytes) -> bytes:
        """Take received bytes."""
        return b""

    def close(self) -> None:
        """Do nothing."""


@dataclass(eq=False)
class Client:
    """One accepted connection."""

    number: int
    connection: wire.Connection
    session: Session


class Port:
    """One listening port with its clients and the faults of its wire."""

    def __init__(self, name: str, listener: socket.socket, greet: Callable[[], bytes]) -> None:
        self.name = name
        self.listener = listener
        self.greet = greet
        self.clients: list[Client] = []
        self.faults: dict[str, Fault] = {}
        self._hooks: dict[str, wire.WireHook] = {}

    @property
    def silent(self) -> bool:
        """Whether nothing may be read, sent or accepted."""
        return "silence" in self.faults

    def begin(self, fault: Fault) -> None:
        """Let a fault of the wire begin."""
        self.faults[fault.kind] = fault
        if fault.kind in HOOKS:
            self._hooks[fault.kind] = HOOKS[fault.kind](fault.parameters)
            self._apply_hooks()

    def end(self, kind: str) -> None:
        """Let it end."""
        self.faults.pop(kind, None)
        if self._hooks.pop(kind, None) is not None:
            self._apply_hooks()

    def add(self, client: Client) -> None:
        """Take a new client, with the present faults of the wire."""
        client.connection.hook = wire.chain(self._hooks.values())
        self.clients.append(client)

    def _apply_hooks(self) -> None:
        hook = wire.chain(self._hooks.values())
        for client in self.clients:
            client.connection.hook = hook
