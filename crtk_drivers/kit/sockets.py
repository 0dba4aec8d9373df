"""Transports over TCP and UDP: opened by a deadline, read by a deadline, given up from any thread."""

from __future__ import annotations

import errno
import select
import socket
import time
from collections.abc import Callable

from typing_extensions import override

from crtk_drivers.device.giving_up import is_given_up
from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit.ready import await_connection, is_ready
from crtk_drivers.kit.robot_ports import script_port

__all__ = ["ClosedByPeer", "TcpTransport", "UdpTransport"]


class ClosedByPeer(ConnectionLost):
    """The other side has closed the connection in good order: it has said all that it had to say."""


def _never() -> bool:
    return False


class _SocketTransport:
    """What both have in common; see `crtk_drivers.kit.Transport`.

    Args:
        host: address or name.
        port: its number.
        what: the device or service, for messages.
        remedy: what to do when it cannot be reached.
        aborted: asked every now and then while something is waited for: whether to give up; beside `abort`,
            and beside the core, which gives up what `Device.open` waits for when the program ends.
        clock: monotonic seconds.
        send_buffer: bytes, some hundred of the system's own with each datagram, that may wait to be sent: as
            datagrams do for a second while nobody answers for their address. 0: as many as the system lets.
    """

    _kind: socket.SocketKind
    _name: str

    def __init__(
        self,
        host: str,
        port: int,
        what: str = "",
        remedy: str = "Check the address, the cable, and that the device is on.",
        *,
        aborted: Callable[[], bool] = _never,
        clock: Callable[[], float] = time.monotonic,
        send_buffer: int = 0,
    ) -> None:
        self.host = host
        self.port = port
        self._what = what or self._name
        self._remedy = remedy
        self._asked = aborted
        self._clock = clock
        self._send_buffer = send_buffer
        self._aborted = False
        self._socket: socket.socket | None = None

    @property
    def where(self) -> str:
        """What it is, host and port, for messages."""
        return f"{self._what} {self.host}:{self.port}"

    @property
    def is_open(self) -> bool:
        """Whether it was opened, and not closed since."""
        return self._socket is not None

    def open(self, deadline: float) -> None:
        """Connect, anew if it is connected.

        Raises:
            ConnectionFailed: not by the monotonic `deadline`.
        """
        self.close()
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                self.host, self.port, socket.AF_INET, self._kind
            )[0]
            self._socket = peer = socket.socket(family, kind, protocol)
            if self._send_buffer:
                peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._send_buffer)
            self._prepare(peer)
            await_connection(peer, address, lambda: self._wait(select.POLLOUT, deadline))
        except OSError as error:
            self.close()
            raise ConnectionFailed(
                f"cannot connect: {error.strerror or error}", where=self.where, remedy=self._remedy
            ) from error

    def _prepare(self, peer: socket.socket) -> None:
        """Set the options of a new socket."""

    def close(self) -> None:
        """Disconnect. May be called twice."""
        peer, self._socket = self._socket, None
        if peer is not None:
            peer.close()

    def abort(self) -> None:
        """End what waits, from any thread; later calls fail."""
        self._aborted = True

    def read(self, deadline: float, most: int = 65536) -> bytes:
        """Return what has arrived as soon as there is any; nothing if none came by the monotonic `deadline`.

        Raises:
            ClosedByPeer, ConnectionLost: the connection is gone, or given up.
        """
        try:
            while self._wait(select.POLLIN, deadline):
                try:
                    data = self._peer.recv(most)
                except BlockingIOError:
                    continue
                if not data and self._kind is socket.SOCK_STREAM:
                    raise ClosedByPeer(
                        "the other side closed the connection", where=self.where, remedy=self._again
                    )
                return data
        except OSError as error:
            if isinstance(error, ClosedByPeer):
                raise
            raise self._lost(error) from error
        return b""

    def write(self, data: bytes) -> None:
        """Send all of `data`, at once.

        Raises:
            ConnectionLost: the connection is gone, or takes no more.
        """
        try:
            if self._peer.send(data) != len(data):
                raise BlockingIOError
        except BlockingIOError as error:
            raise self._lost(OSError(errno.EAGAIN, "its buffer is full")) from error
        except OSError as error:
            raise self._lost(error) from error

    def _wait(self, events: int, deadline: float) -> bool:
        poll = select.poll()
        poll.register(self._peer, events)
        return is_ready(poll, deadline, self._clock, self._is_given_up)

    def _is_given_up(self) -> bool:
        return self._aborted or self._asked() or is_given_up()

    @property
    def _peer(self) -> socket.socket:
        if self._socket is None:
            raise OSError(errno.ENOTCONN, "it is closed")
        return self._socket

    def _lost(self, error: OSError) -> ConnectionLost:
        return ConnectionLost(
            f"the connection is gone: {error.strerror or error}",
            where=self.where,
            remedy=self._again,
        )

    @property
    def _again(self) -> str:
        return f"{self._remedy} The driver connects again by itself."


class TcpTransport(_SocketTransport):
    """A TCP connection, without delay. Bytes, in no portions: see `crtk_drivers.kit.decoding`.

    It connects to no port at which a robot would run what it is sent (`crtk_drivers.kit.robot_ports`).
    """

    _kind = socket.SOCK_STREAM
    _name = "TCP"

    @override
    def open(self, deadline: float) -> None:
        """See `_SocketTransport`."""
        if danger := script_port(self.port):
            raise ConnectionFailed(
                f"not connected: {danger}",
                where=self.where,
                remedy="Give the port of the device itself.",
            )
        super().open(deadline)

    @override
    def _prepare(self, peer: socket.socket) -> None:
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


class UdpTransport(_SocketTransport):
    """Datagrams to and from one address; `read` returns one, whole; one without bytes is as none."""

    _kind = socket.SOCK_DGRAM
    _name = "UDP"
