"""The clients of all ports: accepted, read, answered and closed, without ever waiting for one of them."""

from __future__ import annotations

import logging
import select
import socket
import time
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

from crtk_sim_backends import wire
from crtk_sim_backends.kit import Client, Port, Session
from crtk_sim_backends.process import SimStartError, listen
from crtk_sim_backends.ur.pace import Statistics
from crtk_sim_backends.ur.ports.interpreter_port import InterpreterSession
from crtk_sim_backends.ur.ports.robot_api import RobotApiSession
from crtk_sim_backends.ur.ports.rtde import RtdeError

CONTROL: Final = "control"
"""The port of the simulator itself, which its faults leave alone."""

_EACH_PERIOD: Final = ("realtime", "realtime_read_only", "tool")
"""Ports whose clients are sent something, or may be, in each period."""

_SEND_BUFFER: Final = 65536  # bytes that the kernel keeps for one client
_BACKLOG_LIMIT: Final = 1 << 18  # bytes of untaken replies that end a connection
_CONTROL_BACKLOG_LIMIT: Final = 1 << 27  # the same on the control socket: whole traces
_HIGHEST_FD: Final = 1023  # that `select` can watch
_WAKE_UPS: Final = 8  # times that data is handled on arrival in one period, then at its end

log = logging.getLogger(__name__)


class Service(Protocol):
    """What the clients have come for. Ports go by their names."""

    @property
    def stopping(self) -> bool:
        """Whether it ends."""

    def stop(self) -> None:
        """End it."""

    def limit(self, port: str) -> int:
        """How many clients a port lets in."""

    def session(self, port: str, number: int) -> Session:
        """Return what answers a new client."""

    def greeting(self, port: str) -> bytes:
        """Return what a new client is told first."""

    def connected(self, port: str) -> None:
        """Note that a client has come."""

    def catch_up(self) -> None:
        """Come to the present: what has arrived is handled next."""


class Clients:
    """The ports and who is connected to them.

    Args:
        service: what they have come for.
        statistics: counts them, and defects.
        speed: of the wires' time, in times real time.
        parent_fd: file descriptor that becomes readable when the process that wants this simulator
            has died, None for none.

    Attributes:
        ports: by name.
        stalled: whether only the control port is read.
        changed: whether another set of connections is to be read from now on.
    """

    def __init__(
        self, service: Service, statistics: Statistics, speed: float, parent_fd: int | None
    ) -> None:
        self.ports: dict[str, Port[Session]] = {}
        self.stalled = False
        self.changed = True
        self._flooded = False  # more arrives in a period than is handled on arrival
        self._service = service
        self._statistics = statistics
        self._speed = speed
        self._parent_fd = parent_fd
        self._by_fd: dict[int, Port[Session] | tuple[Port[Session], Client[Session]]] = {}
        self._watched: list[int] = []

    def bind(self, host: str, numbers: Mapping[str, int]) -> None:
        """Listen on `host` at those port numbers, by name.

        Raises:
            SimStartError: one cannot be bound; none is left open then.
        """
        try:
            for name, number in numbers.items():
                self.ports[name] = Port(name, listen(host, number, name))
        except SimStartError:
            self.close()
            raise

    def close(self) -> None:
        """Close every connection and port."""
        for port in self.ports.values():
            for client in port.clients:
                client.connection.close()
            port.clients.clear()  # a program that was not complete is not run now
            port.close()
        self.ports.clear()

    def serve_until(self, deadline: Callable[[], float]) -> None:
        """Handle what arrives until the deadline, which what arrives may change; at least once."""
        self._flooded = False
        for _ in range(_WAKE_UPS):
            if self.changed:
                self._watch()
            wait = deadline() - time.monotonic()
            ready, _, _ = select.select(self._watched, (), (), max(0.0, wait))
            if ready:
                self._service.catch_up()
                self._handle(ready, time.monotonic() * self._speed)
            if wait <= 0.0 or self._service.stopping or not ready:
                return
        self._flooded = True
        time.sleep(max(0.0, deadline() - time.monotonic()))

    @property
    def busy(self) -> bool:
        """Whether somebody is sent something in each period, waits for the next, or for what is under way."""
        if self.stalled or self._flooded:
            return True
        for port in self.ports.values():
            for client in port.clients:
                connection = client.connection
                if (
                    port.name in _EACH_PERIOD
                    or connection.has_input
                    or connection.has_output
                    or connection.ended
                    or _waits(client)
                ):
                    return True
        return False

    def _handle(self, ready: list[int], now: float) -> None:
        for fd in ready:
            owner = self._by_fd.get(fd)
            if owner is None:
                if fd == self._parent_fd:
                    log.info("the process that started this simulator has ended")
                    self._service.stop()
            elif isinstance(owner, Port):
                self._accept(owner, now)
            elif not owner[1].connection.closed:
                port, client = owner
                client.connection.read(now)
                if client.connection.peer_closed:
                    self.changed = True
                if port.name != CONTROL:  # whose requests are done at the next period
                    self._process(port, client, now)

    def _watch(self) -> None:
        """Collect the file descriptors that are read now."""
        self.changed = False
        self._by_fd = {}
        for port in self.ports.values():
            if port.silent or (self.stalled and port.name != CONTROL):
                continue
            if port.listener is not None:
                self._by_fd[port.listener.fileno()] = port
            for client in port.clients:
                if not client.connection.ended:
                    self._by_fd[client.connection.fileno()] = (port, client)
        self._watched = list(self._by_fd)
        if self._parent_fd is not None:
            self._watched.append(self._parent_fd)

    def _accept(self, port: Port[Session], now: float) -> None:
        while port.listener is not None:
            try:
                sock, _ = port.listener.accept()
            except BlockingIOError:
                break
            except OSError as error:
                log.warning("cannot accept on the %s port: %s", port.name, error)
                break
            full = (
                len(port.clients) >= self._service.limit(port.name) or sock.fileno() > _HIGHEST_FD
            )
            if full or "disconnect" in port.faults:
                sock.close()
                continue
            self._welcome(port, sock, now)

    def _welcome(self, port: Port[Session], sock: socket.socket, now: float) -> None:
        """Make a client of an accepted connection."""
        limit = _CONTROL_BACKLOG_LIMIT if port.name == CONTROL else _BACKLOG_LIMIT
        try:
            send_buffer = round(_SEND_BUFFER * max(1.0, self._speed))
            connection = wire.Connection(sock, limit, send_buffer=send_buffer)
        except OSError as error:
            log.info("a client of the %s port was gone at once: %s", port.name, error)
            sock.close()
            return
        self._statistics.accepted += 1
        number = self._statistics.accepted
        session = self._service.session(port.name, number) if port.answers else None
        port.add(Client(connection, session, number))
        self.changed = True
        self._service.connected(port.name)
        if session is not None:
            connection.send(self._service.greeting(port.name), now)

    def do_requests(self, now: float) -> list[tuple[Client[Session], bytes]]:
        """Do what was asked on the control socket; it is answered once that has taken effect."""
        answers = []
        for client in self.ports[CONTROL].clients:
            client.connection.flush(now)
            if client.connection.has_input or client.connection.ended:
                answers.append((client, self._answer(CONTROL, client, now)))
        return answers

    def answer(self, answers: list[tuple[Client[Session], bytes]], now: float) -> None:
        """Answer requests on the control socket."""
        for client, answer in answers:
            client.connection.send(answer, now)
            self._remove_if_ended(self.ports[CONTROL], client)

    def push(self, now: float) -> None:
        """Move on what slow peers and delaying wires have held back; not on the control socket."""
        for port in self.ports.values():
            if not port.silent and port.clients and port.name != CONTROL:
                self._push(port, now)

    def _push(self, port: Port[Session], now: float) -> None:
        for client in list(port.clients):
            client.connection.flush(now)
            if client.connection.has_input or client.connection.ended or _waits(client):
                self._process(port, client, now)

    def _process(self, port: Port[Session], client: Client[Session], now: float) -> None:
        """Let a client's session take what has arrived, and send its answer."""
        client.connection.send(self._answer(port.name, client, now), now)
        self._remove_if_ended(port, client)

    def _answer(self, port: str, client: Client[Session], now: float) -> bytes:
        """What a client's session answers to what has arrived."""
        connection = client.connection
        try:
            pieces = connection.take(now) or ([b""] if _waits(client) else [])
            return b"".join([client.receive(piece) for piece in pieces])
        except RtdeError as error:
            log.warning("closing %s connection %d: %s", port, client.number, error)
        except Exception:
            self._statistics.defects += 1
            log.exception("a defect of the simulator closes %s client %d", port, client.number)
        connection.close()
        return b""

    def _remove_if_ended(self, port: Port[Session], client: Client[Session]) -> None:
        if client.connection.ended or client.ended:
            self.remove(port, client)

    def remove(self, port: Port[Session], client: Client[Session]) -> None:
        """Close the connection of a client."""
        port.clients.remove(client)
        self.changed = True
        try:
            client.close()
        except Exception:
            self._statistics.defects += 1
            log.exception("a defect of the simulator, as %s client %d went", port, client.number)

    def disconnect(self, port: Port[Session]) -> None:
        """Close all connections of a port."""
        for client in list(port.clients):
            self.remove(port, client)

    def broadcast(self, names: tuple[str, ...], build: Callable[[], bytes], now: float) -> None:
        """Send one package to every client that keeps up; it is built only when there is one."""
        package: bytes | None = None
        for name in names:
            port = self.ports[name]
            if port.silent:
                continue
            for client in port.clients:
                if client.connection.blocked or client.session is None:
                    client.connection.dropped += 1
                    continue
                package = build() if package is None else package
                client.connection.send_fresh(package, now)

    def connections(self, port: Port[Session]) -> list[dict[str, Any]]:
        """Who is connected to a port, and how much went over the wire, ready for JSON."""
        return [
            {
                "number": client.number,
                "bytes_in": client.connection.bytes_in,
                "bytes_out": client.connection.bytes_out,
                "dropped": client.connection.dropped,
                "packages_in": getattr(client.session, "packages_in", None),
                "packages_bad": getattr(client.session, "packages_bad", None),
            }
            for client in port.clients
        ]


def _waits(client: Client[Session]) -> bool:
    """Whether a client's command is not answered yet."""
    return (
        isinstance(client.session, RobotApiSession | InterpreterSession) and client.session.waiting
    )
