"""A listening TCP port, without a loop: its clients, their sessions, and the faults of its wire."""

from __future__ import annotations

import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, Protocol, TypeVar

from crtk_sim_backends import wire
from crtk_sim_backends.faults import Fault
from crtk_sim_backends.kit.wire_faults import HOOKS
from crtk_sim_backends.process import listen, listen_in_files

LONGEST_LINE: Final = 4096


class Session(Protocol):
    """One client: bytes in, bytes out. `ended` asks for the connection to be closed."""

    ended: bool

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return what to send."""

    def close(self) -> None:
        """Let go of everything: the client is gone."""


class LineSession:
    """A client that sends lines of text, and gets lines back.

    Args:
        obey: takes a line without its end, and returns the answer without its end; None: there is none.
        end: of a line. A carriage return before it is dropped.

    What is longer than `LONGEST_LINE` bytes is forgotten.
    """

    ended = False

    def __init__(self, obey: Callable[[str], str | None], end: bytes = b"\n") -> None:
        self._obey = obey
        self._end = end
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers to the lines that they complete."""
        *lines, self._rest = (self._rest + data).split(self._end)
        if len(self._rest) > LONGEST_LINE:
            self._rest = b""
        answers = [
            self._obey(line.decode("ascii", "replace").rstrip("\r"))
            for line in lines
            if len(line) <= LONGEST_LINE
        ]
        return b"".join(text.encode() + self._end for text in answers if text is not None)

    def close(self) -> None:
        """Forget an unfinished line."""
        self._rest = b""


SessionT = TypeVar("SessionT", bound=Session)


@dataclass(eq=False)
class Client(Generic[SessionT]):
    """One accepted connection.

    Attributes:
        session: None if it is never answered: it came during the fault ``no_answer``.
        number: counts the connections of a simulator, where it does.
    """

    connection: wire.Connection
    session: SessionT | None
    number: int = 0

    @property
    def ended(self) -> bool:
        """Whether its session asks for the connection to be closed."""
        return self.session is not None and self.session.ended

    def receive(self, data: bytes) -> bytes:
        """Hand received bytes to its session, and return what to send."""
        return b"" if self.session is None else self.session.receive(data)

    def close(self) -> None:
        """Close the connection, then the session."""
        self.connection.close()
        if self.session is not None:
            self.session.close()


class Port(Generic[SessionT]):
    """One listening port.

    Args:
        name: of the port.
        listener: listening socket, which it closes.
    """

    def __init__(self, name: str, listener: socket.socket) -> None:
        self.name = name
        place = listener.getsockname()
        self.host: str
        self.number: int
        self.host, self.number = (place, 0) if listener.family == socket.AF_UNIX else place
        self.listener: socket.socket | None = listener
        self.clients: list[Client[SessionT]] = []
        self.faults: dict[str, Fault] = {}
        self._hooks: dict[str, wire.WireHook] = {}

    @property
    def silent(self) -> bool:
        """Whether nothing may be read, sent or accepted."""
        return "silence" in self.faults

    @property
    def answers(self) -> bool:
        """Whether who connects from now on has a session, and is answered."""
        return "no_answer" not in self.faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        self.faults[fault.kind] = fault
        if fault.kind in HOOKS:
            self._hooks[fault.kind] = HOOKS[fault.kind](fault.parameters)
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
            self.listener = (
                listen(self.host, self.number, self.name)
                if self.number
                else listen_in_files(Path(self.host))
            )

    def add(self, client: Client[SessionT]) -> None:
        """Take a new client, with the present faults of the wire."""
        client.connection.hook = wire.chain(self._hooks.values())
        self.clients.append(client)

    def remove(self, client: Client[SessionT]) -> None:
        """Close the connection of a client."""
        self.clients.remove(client)
        client.close()

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
