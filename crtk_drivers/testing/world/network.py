"""What is behind the sockets of a world: TCP, UDP and Unix sockets on one machine, with a network's weather.

A TCP connection keeps its order, whatever the weather: a late piece makes those behind it late. A datagram
may be lost, doubled or overtaken. Unix sockets lose nothing.
"""

from __future__ import annotations

import _socket as socket
import errno
from collections import deque
from typing import Any, Final, Protocol

from typing_extensions import Buffer, override

from crtk_drivers.testing.world.files import ERROR, HANG_UP, READ, WRITE, OpenFile, fail
from crtk_drivers.testing.world.kernel import NS, NotSimulated, Process, here

Address = Any
"""As Python's sockets have it: host and port, or a path."""

TCP_ROOM: Final = 1 << 18
"""Bytes of a connection that are on their way or not read yet; more of them wait at the sender."""
DATAGRAM_ROOM: Final = 400
"""Datagrams that wait to be read; more of them are lost."""
_ANYWHERE: Final = "0.0.0.0"
_LOOPBACK: Final = "127.0.0.1"
_KINDS: Final = (socket.SOCK_STREAM, socket.SOCK_DGRAM, socket.SOCK_SEQPACKET)


class Weather(Protocol):
    """What becomes of what is sent."""

    def stream_piece(self, size: int) -> tuple[float, int]:
        """Return the s that a piece of a TCP stream takes, and where it is cut in two (0: nowhere)."""

    def handshake(self) -> float:
        """Return the s that one way of connecting or ending takes."""

    def moment(self) -> float:
        """Return the s that something takes within the machine, whatever the network does."""

    def datagram(self) -> list[float]:
        """Return the s after which a datagram arrives, of each copy; empty if it is lost."""


class Network:
    """Addresses of a world, and its weather."""

    def __init__(self, weather: Weather) -> None:
        self.weather = weather
        self.bound: dict[tuple[int, int, Any], Endpoint] = {}
        self.streams: list[Endpoint] = []  # ends of TCP connections, for a fault to choose from
        self.packets = 0
        self._port = 40_000

    def free_port(self) -> int:
        """Return a port that nobody has had."""
        self._port += 1
        return self._port

    def at(self, endpoint: Endpoint, address: Address) -> Endpoint | None:
        """Return who is bound at an address, for a socket of the same kind."""
        found = self.bound.get((endpoint.family, endpoint.kind, address))
        if found is None and endpoint.family == socket.AF_INET:
            found = self.bound.get((endpoint.family, endpoint.kind, (_ANYWHERE, address[1])))
        return found


class _Current:
    network: Network | None = None


_current = _Current()


def begin(network: Network) -> None:
    """Let sockets be in this network."""
    _current.network = network


def network() -> Network:
    """Return the network of this world."""
    here()  # which says so when there is none
    assert _current.network is not None
    return _current.network


class Endpoint(OpenFile):
    """One socket.

    Attributes:
        name: its own address.
        peer_name: that of the other side.
        peer: the other end of a connection.
        owner: its process.
        error: number of an error that the next call raises.
    """

    def __init__(self, family: int, kind: int, owner: Process | None = None) -> None:
        super().__init__()
        if family not in (socket.AF_INET, socket.AF_UNIX):
            fail(errno.EAFNOSUPPORT)
        if kind not in _KINDS:
            raise NotSimulated(f"sockets of type {kind}")
        self.family = family
        self.kind = kind
        self.owner: Process = owner or here().process
        self.name: Address = (_ANYWHERE, 0) if family == socket.AF_INET else ""
        self.peer_name: Address = None
        self.peer: Endpoint | None = None
        self.error = 0
        self.options: dict[tuple[int, int], Any] = {}
        self._bytes = bytearray()  # of a stream, to be read
        self.packets: deque[tuple[bytes, list[int | OpenFile], Address]] = deque()
        self.pending: deque[Endpoint] = deque()  # connections to be accepted
        self.backlog = -1  # that of a listener
        self.connecting = False
        self._has_ended = False  # the other side sends no more
        self._is_shut = False  # this side sends no more
        self._under_way = 0  # bytes to the peer
        self._last = 0  # ns; when the last of them arrives

    # What it is

    @property
    def keeps_packets(self) -> bool:
        """Whether what is sent is read as it was sent."""
        return self.kind != socket.SOCK_STREAM

    @property
    def label(self) -> str:
        """What the trace calls it."""
        return f"{self.name} to {self.peer_name}"

    @property
    def is_connected_kind(self) -> bool:
        """Whether it needs a connection."""
        return self.kind != socket.SOCK_DGRAM

    @property
    def is_tcp(self) -> bool:
        """Whether it is in the network's weather, and keeps the order."""
        return self.family == socket.AF_INET and self.kind == socket.SOCK_STREAM

    @override
    def events(self) -> int:
        if self.backlog >= 0:
            return READ if self.pending else 0
        if self.connecting:
            return 0
        found = READ if self._bytes or self.packets or self.error else 0
        if not self.is_connected_kind:
            return found | WRITE
        if self._has_ended:
            found |= READ
        if self.peer is not None and not self._is_full():
            found |= WRITE
        if self.error:
            found |= WRITE | ERROR | HANG_UP
        elif self.peer is None or (self._has_ended and self._is_shut):
            found |= WRITE | HANG_UP
        return found

    def _is_full(self) -> bool:
        peer = self.peer
        return peer is not None and self._under_way + peer.unread >= TCP_ROOM

    @property
    def unread(self) -> int:
        """Bytes that have arrived."""
        return len(self._bytes) + sum(len(data) for data, _, _ in self.packets)

    def take_error(self) -> int:
        """Return the number of the error that is due, once; 0 if there is none."""
        found, self.error = self.error, 0
        return found

    def raise_error(self) -> None:
        """Raise the error that is due."""
        if self.error:
            fail(self.take_error())

    # Addresses

    def bind(self, address: Address) -> None:
        """As `socket.bind`."""
        if self.family == socket.AF_INET:
            host, port = address
            address = host or _ANYWHERE, port or network().free_port()
        key = self.family, self.kind, address
        if key in network().bound:
            fail(errno.EADDRINUSE)
        self.name = address
        network().bound[key] = self

    def listen(self, backlog: int) -> None:
        """As `socket.listen`."""
        self.backlog = backlog

    def connect(self, address: Address) -> int:
        """Begin to connect; return 0, or EINPROGRESS if `events` will tell."""
        self.peer_name = address
        if self.family == socket.AF_INET and self.name[1] == 0:
            self.name = _LOOPBACK, network().free_port()
            if not self.is_connected_kind:
                network().bound[self.family, self.kind, self.name] = self
        if not self.is_connected_kind:
            return 0
        if self.family == socket.AF_UNIX:
            self._knock()
            return self.take_error()
        self.connecting = True
        here().after(network().weather.handshake(), self._knock)
        return errno.EINPROGRESS

    def _knock(self) -> None:
        """Arrive at the listener."""
        listener = network().at(self, self.peer_name)
        if not self.is_open or (listener is not None and listener.owner.vanished):
            return  # nobody answers
        if listener is None or listener.backlog < 0:
            self.error = errno.ECONNREFUSED
        elif len(listener.pending) > listener.backlog:
            if self.is_tcp:
                return  # as Linux does: it is tried again, and that takes a second
            self.error = errno.EAGAIN
        else:
            far = Endpoint(self.family, self.kind, listener.owner)
            far.name, far.peer_name = self.peer_name, self.name
            far.peer, self.peer = self, far
            listener.pending.append(far)
            listener.changed()
            if self.is_tcp:
                network().streams.append(self)
        self.connecting = False
        here().note("connected", self.label, self.error)
        self.changed()

    # Sending

    def send_stream(self, data: Buffer) -> int:
        """Send what there is room for; 0 if there is none.

        Raises:
            OSError: the connection has ended.
        """
        self.raise_error()
        peer = self.peer
        if self._is_shut or peer is None:
            fail(errno.EPIPE)
        if self._is_full():
            return 0
        piece = bytes(data)[: TCP_ROOM - self._under_way - peer.unread]
        seconds, cut = network().weather.moment(), 0
        if self.is_tcp:
            seconds, cut = network().weather.stream_piece(len(piece))
        parts = (piece[:cut], piece[cut:]) if 0 < cut < len(piece) else (piece,)
        for number, part in enumerate(parts):
            self._carry(part, seconds + 0.001 * number)
        return len(piece)

    def _carry(
        self, data: bytes | None, seconds: float, passed: list[int | OpenFile] | None = None
    ) -> None:
        """Let data arrive, in order; None is the end."""
        kernel, peer = here(), self.peer
        assert peer is not None
        self._last = max(self._last + 1, kernel.now + int(seconds * NS))
        self._under_way += len(data or b"")
        network().packets += 1
        kernel.note("sent", self.label, data)

        def arrive() -> None:
            self._under_way -= len(data or b"")
            if peer.owner.vanished or peer.peer is not self:
                return
            if data is None:
                peer._has_ended = True  # noqa: SLF001 - the other end of this one
            elif not peer.is_open and not peer.is_pending():
                self.reset()
                return
            elif self.keeps_packets:
                peer.packets.append((data, passed or [], self.name))
            else:
                peer._bytes += data  # noqa: SLF001
            peer.changed()

        kernel.at(self._last, arrive)

    def is_pending(self) -> bool:
        """Whether it waits to be accepted."""
        listener = network().at(self, self.name)
        return listener is not None and self in listener.pending

    def send_packet(self, data: Buffer, address: Address, passed: list[int | OpenFile]) -> int:
        """Send a datagram, or a packet of a connection; -1 if there is no room.

        Raises:
            OSError: there is nobody, or no connection.
        """
        self.raise_error()
        piece = bytes(data)
        if self.is_connected_kind:
            if self._is_shut or self.peer is None:
                fail(errno.EPIPE)
            if self._is_full():
                return -1
            self._carry(piece, network().weather.moment(), passed)
            return len(piece)
        address = self.peer_name if address is None else address
        if address is None:
            fail(errno.EDESTADDRREQ)
        if self.family == socket.AF_INET and self.name[1] == 0:
            self.bind((_LOOPBACK, 0))
        network().packets += 1
        here().note("sent", self.label, piece)
        weather = network().weather
        delays = [weather.moment()] if self.family == socket.AF_UNIX else weather.datagram()
        for seconds in delays:
            here().after(seconds, lambda: self._land(piece, address))
        return len(piece)

    def _land(self, data: bytes, address: Address) -> None:
        peer = network().at(self, address)
        if peer is None:
            if self.peer_name is not None and self.is_open:
                self.error = errno.ECONNREFUSED  # by ICMP, to a connected socket only
                self.changed()
        elif peer.owner.vanished:
            return
        elif peer.peer_name in (None, self.name) and len(peer.packets) < DATAGRAM_ROOM:
            peer.packets.append((data, [], self.name))
            peer.changed()

    # Receiving

    def take_bytes(self, most: int, *, peek: bool) -> bytes | None:
        """Return what has arrived of a stream, empty at its end; None if nothing has.

        Raises:
            OSError: the connection was reset, or there is none.
        """
        if not self._bytes:
            if self.error:
                self._has_ended = True
                self.raise_error()
            if self._has_ended:
                return b""
            if self.peer is None:
                fail(errno.ENOTCONN)
            return None
        found = bytes(self._bytes[:most])
        if not peek:
            sender = self.peer
            is_awaited = sender is not None and sender._is_full()  # noqa: SLF001 - the other end
            del self._bytes[:most]
            if sender is not None and is_awaited:
                sender.changed()
        return found

    def take_packet(self, *, peek: bool) -> tuple[bytes, list[int | OpenFile], Address] | None:
        """Return the next packet, what was passed with it, and who sent it; None if there is none.

        Raises:
            OSError: an error is due.
        """
        self.raise_error()
        if not self.packets:
            return (b"", [], None) if self._has_ended else None
        return self.packets[0] if peek else self.packets.popleft()

    # The end

    def shutdown(self, how: int) -> None:
        """As `socket.shutdown`."""
        if self.peer_name is None or (
            self.is_connected_kind and self.peer is None and not self.error
        ):
            fail(errno.ENOTCONN)
        if how != socket.SHUT_RD:
            self._end_sending()
        if how != socket.SHUT_WR:
            self._has_ended = True
        self.changed()

    def _end_sending(self) -> None:
        if not self._is_shut and self.peer is not None:
            self._is_shut = True
            weather = network().weather
            self._carry(None, weather.handshake() if self.is_tcp else weather.moment())

    def reset(self) -> None:
        """Tear the connection: both sides see an error."""
        here().note("reset", self.label)
        for side in (self, self.peer):
            if side is not None and side.is_open and not side.error:
                side.error, side.peer = errno.ECONNRESET, None
                side._bytes.clear()  # noqa: SLF001 - the other end of this one
                side.changed()

    @override
    def released(self) -> None:
        bound = network().bound
        for key in [key for key, endpoint in bound.items() if endpoint is self]:
            del bound[key]
        if self in network().streams:
            network().streams.remove(self)
        for waiting in self.pending:
            waiting.reset()
        if self.peer is None:
            return
        if self.is_tcp and self._bytes:
            self.reset()  # what nobody has read: the system says so to the sender
        else:
            self._end_sending()

    @override
    def read(self, most: int) -> bytes:
        raise NotSimulated("os.read of a socket")

    @override
    def write(self, data: Buffer) -> int:
        raise NotSimulated("os.write to a socket")
