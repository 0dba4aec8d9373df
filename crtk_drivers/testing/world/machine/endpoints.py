"""What is behind a socket of a world: TCP, UDP or Unix, on one machine, with a network's weather.

A TCP connection keeps its order, whatever the weather: a late piece makes those behind it late. A datagram
may be lost, doubled or overtaken. Unix sockets lose nothing.
"""

from __future__ import annotations

import _socket as socket
import errno
import os
import stat
import struct
from collections import deque
from collections.abc import Callable
from typing import Any, Final, TypeVar

from typing_extensions import Buffer, override

from crtk_drivers.testing.world.machine.files import (
    ERROR,
    HANG_UP,
    PEER_ENDED,
    READ,
    WRITE,
    OpenFile,
    fail,
    held,
)
from crtk_drivers.testing.world.machine.kernel import EPOCH, NS, NotSimulated, Process, here
from crtk_drivers.testing.world.machine.network import (
    ANYWHERE,
    LOOPBACK,
    Address,
    Network,
    arrival,
    is_local,
    unix_key,
)

Found = TypeVar("Found")
Passed = list[int | OpenFile]
"""Descriptors on their way: files of the world, and numbers of real ones."""

TCP_ROOM: Final = 1 << 18
"""Bytes of a connection that are on their way or not read yet; more of them wait at the sender."""
DATAGRAM_ROOM: Final = 400
"""Datagrams that wait to be read; more of them are lost."""
_UNIX_DATAGRAM_ROOM: Final = 11
"""Datagrams of Unix sockets that wait to be read; who sends more waits."""
_LONGEST_DATAGRAM: Final = 65_507
_CONNECTING_AGAIN: Final = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""s after which it is tried again to connect to one who does not answer, as Linux does."""
_KINDS: Final = (socket.SOCK_STREAM, socket.SOCK_DGRAM, socket.SOCK_SEQPACKET)
_LINGER: Final = (socket.SOL_SOCKET, socket.SO_LINGER)
_real_close: Final = os.close


class _Current:
    network: Network[Endpoint] | None = None


_current = _Current()


def begin(network: Network[Endpoint]) -> None:
    """Let sockets be in this network."""
    _current.network = network


def network() -> Network[Endpoint]:
    """Return the network of this world."""
    here()  # which says so when there is none
    assert _current.network is not None
    return _current.network


class Endpoint(OpenFile):
    """One socket.

    Attributes:
        name: its own address.
        peer_name: that of the other side.
        peer: the other end of a connection, or of a pair.
        owner: its process.
        error: number of an error that the next call raises.
    """

    mode = stat.S_IFSOCK

    def __init__(self, family: int, kind: int, owner: Process | None = None) -> None:
        super().__init__()
        if family not in (socket.AF_INET, socket.AF_UNIX):
            fail(errno.EAFNOSUPPORT)
        if kind not in _KINDS:
            fail(errno.EINVAL)
        if family == socket.AF_INET and kind == socket.SOCK_SEQPACKET:
            fail(errno.ESOCKTNOSUPPORT)
        self.family = family
        self.kind = kind
        self.owner: Process = owner or here().process
        self.name: Address = (ANYWHERE, 0) if family == socket.AF_INET else ""
        self.peer_name: Address = None
        self.peer: Endpoint | None = None
        self.error = 0
        self.options: dict[tuple[int, int], Any] = {}
        self.pending: deque[Endpoint] = deque()  # connections to be accepted
        self.backlog = -1  # that of a listener
        self._state = _NEW
        self._is_told = True  # that it is connected, to one who did not wait for it
        self._bytes = bytearray()  # of a stream, to be read
        self._marks: deque[tuple[int, int, Passed]] = (
            deque()
        )  # descriptors between two places of it
        self._place = 0  # of its first byte, from the beginning
        self._packets: deque[tuple[bytes, Passed, Address]] = deque()
        self._arrivals: deque[int] = deque()
        self.arrived = 0
        """When the UDP datagram that was taken last arrived, ns since the epoch; 0: there was none."""
        self._senders: dict[Endpoint, None] = {}  # who waits for room among the packets
        self._has_ended = False  # nothing comes any more
        self._is_shut = False  # nothing is sent any more
        self._is_end_heard = False  # the other side knows
        self._ended_first = False
        self._under_way = 0  # bytes to the peer
        self._last = 0  # ns; when the last of what was sent arrives

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
    def is_internet(self) -> bool:
        """Whether it is in the network's weather."""
        return self.family == socket.AF_INET

    @property
    def is_tcp(self) -> bool:
        """Whether it is in the network's weather, and keeps the order."""
        return self.is_internet and self.is_connected_kind

    @property
    def is_connected(self) -> bool:
        """Whether it has a connection."""
        return self._state == _CONNECTED

    @property
    def is_listening(self) -> bool:
        """Whether it accepts connections."""
        return self._state == _LISTENING

    @override
    def events(self) -> int:
        found = ERROR if self.error else 0
        if self.is_listening:
            return READ if self.pending else 0
        if self._state == _CONNECTING:
            return found
        if self._bytes or self._packets:
            found |= READ
        if self._has_ended:
            found |= READ | PEER_ENDED
        if (self._has_ended and self._is_shut) or (
            self.is_connected_kind and self._state in (_NEW, _ENDED)
        ):
            found |= HANG_UP
        return found if self._is_full() else found | WRITE

    def _is_full(self) -> bool:
        peer = self.peer
        if peer is None or self._is_shut:
            return False
        if self.is_connected_kind:
            return self._under_way + peer.unread() >= TCP_ROOM
        if self.is_internet or len(peer._packets) < _UNIX_DATAGRAM_ROOM:  # noqa: SLF001
            return False
        peer._senders[self] = None  # noqa: SLF001 - the other end of this one
        return True

    @override
    def unread(self) -> int:
        if self.is_connected_kind:
            return len(self._bytes) + sum(len(data) for data, _, _ in self._packets)
        return len(self._packets[0][0]) if self._packets else 0

    def take_error(self) -> int:
        """Return the number of the error that is due, once; 0 if there is none."""
        found, self.error = self.error, 0
        return found

    def raise_error(self) -> None:
        """Raise the error that is due."""
        if self.error:
            fail(self.take_error())

    def set_option(self, level: int, name: int, value: Any) -> None:
        """Keep an option."""
        self.options[level, name] = value

    # Addresses

    def bind(self, address: Address) -> None:
        """As `socket.bind`."""
        if not self.is_internet:
            self._bind_unix(address)
            return
        host, port = address
        if self.name[1]:
            fail(errno.EINVAL)
        if not is_local(host):
            fail(errno.EADDRNOTAVAIL)
        network().claim(self, (host, port or network().free_port()))

    def _bind_unix(self, address: Address) -> None:
        if self.name:
            fail(errno.EINVAL)
        bound = network().bound
        if isinstance(address, str):
            try:
                os.mknod(address, stat.S_IFSOCK | 0o777)  # a socket that the system does not serve
            except FileExistsError:
                fail(errno.EADDRINUSE)
        elif (socket.AF_UNIX, 0, address) in bound:
            fail(errno.EADDRINUSE)
        self.name = address
        bound[socket.AF_UNIX, 0, unix_key(address)] = self

    def listen(self, backlog: int) -> None:
        """As `socket.listen`."""
        if not self.is_connected_kind:
            fail(errno.EOPNOTSUPP)
        if self._state not in (_NEW, _LISTENING) or not (self.is_internet or self.name):
            fail(errno.EINVAL)
        if self.is_internet:
            if not self.name[1]:
                self.bind((ANYWHERE, 0))
            network().bound[socket.AF_INET, self.kind, self.name] = self
        self._state = _LISTENING
        self.backlog = max(0, backlog)

    def accept(self) -> Endpoint | None:
        """Return the next connection, None if there is none yet.

        Raises:
            OSError: it does not listen (EINVAL).
        """
        if not self.is_connected_kind:
            fail(errno.EOPNOTSUPP)
        if not self.is_listening:
            fail(errno.EINVAL)
        if not self.pending:
            return None
        found = self.pending.popleft()
        self.changed()  # for those who wait for a place among them
        return found

    # Connecting

    def connect(self, address: Address, *, waits: bool) -> int:
        """Begin to connect; return 0, the number of an error, or EINPROGRESS if `events` will tell.

        Args:
            address: of the other side.
            waits: whether the system call is to wait for it.
        """
        if not self.is_connected_kind:
            return self._connect_datagrams(address)
        if self._state == _CONNECTING:
            return errno.EALREADY
        if not self._is_told and self._state == _CONNECTED:
            self._is_told = True
            return 0
        if self._state != _NEW:
            return errno.EISCONN if self._state == _CONNECTED else errno.EINVAL
        if not self.is_internet:
            return self._connect_unix(address, waits=waits)
        host, port = address
        self.peer_name = (LOOPBACK, port) if host == ANYWHERE else (host, port)
        if self.name[1] == 0:
            network().have_port(self, (LOOPBACK, network().free_port()))
        elif self.name[0] == ANYWHERE:
            self.name = LOOPBACK, self.name[1]
        self._state, self._is_told = _CONNECTING, waits
        here().after(network().weather.handshake(), lambda: self._knock(0))
        return errno.EINPROGRESS

    def _connect_datagrams(self, address: Address) -> int:
        if not self.is_internet:
            found = network().of_path(address)
            if found is None:
                return errno.ECONNREFUSED
            if found.kind != self.kind:
                return errno.EPROTOTYPE
            self.peer = found
            self.peer_name = address
            return 0
        host, port = address
        self.peer_name = (LOOPBACK, port) if host == ANYWHERE else (host, port)
        if self.name[1] == 0:
            network().have_port(self, (LOOPBACK, network().free_port()))
        elif self.name[0] == ANYWHERE:
            network().forget(self)
            network().have_port(self, (LOOPBACK, self.name[1]))
        return 0

    def _connect_unix(self, address: Address, *, waits: bool) -> int:
        while True:
            listener = network().of_path(address)
            if listener is None:
                return errno.ECONNREFUSED
            if listener.kind != self.kind:
                return errno.EPROTOTYPE
            if not listener.is_listening:
                return errno.ECONNREFUSED
            if len(listener.pending) <= listener.backlog:
                break
            if not waits:
                return errno.EAGAIN
            with held((listener,)):
                here().wait((listener.waiters,))
        self.peer_name = listener.name
        self._meet(listener)
        return 0

    def _knock(self, tries: int) -> None:
        """Arrive at the listener."""
        if not self.is_open or self._state != _CONNECTING:
            return
        listener = network().at(self.kind, self.peer_name)
        is_silent = not is_local(self.peer_name[0]) or (
            listener is not None
            and (listener.owner.vanished or len(listener.pending) > listener.backlog)
        )
        if is_silent:
            if tries < len(_CONNECTING_AGAIN):
                here().after(_CONNECTING_AGAIN[tries], lambda: self._knock(tries + 1))
                return
            self._end(errno.ETIMEDOUT)
        elif listener is None:
            self._end(errno.ECONNREFUSED)
        else:
            self._meet(listener)
            network().streams.append(self)
        here().note("connected", self.label, self.error)
        self.changed()

    def _meet(self, listener: Endpoint) -> None:
        far = Endpoint(self.family, self.kind, listener.owner)
        far.options.update(listener.options)
        far.peer, self.peer = self, far
        far._state = self._state = _CONNECTED
        far.peer_name = self.name
        if far.is_tcp:
            network().have_port(far, self.peer_name)
        else:
            far.name = listener.name
        listener.pending.append(far)
        listener.changed()

    def pair(self, other: Endpoint) -> None:
        """Be connected with another one, as by `socketpair`."""
        for one, far in ((self, other), (other, self)):
            one.peer, one.peer_name = far, ""
            if one.is_connected_kind:
                one._state = _CONNECTED  # noqa: SLF001 - the other end of this one

    def give_up(self) -> None:
        """Be as new after a call that waited for a connection in vain."""
        if self._state == _ENDED:
            self._state, self._is_told = _NEW, True
            self._has_ended = self._is_shut = False

    # Sending

    def send_stream(self, data: Buffer, passed: Passed) -> int | None:
        """Send what there is room for; None if there is none.

        Raises:
            OSError: the connection has ended.
        """
        self.raise_error()
        peer = self.peer
        if self._is_shut or peer is None:
            if self._state == _NEW and not self.is_internet:
                fail(errno.ENOTCONN)
            fail(errno.EPIPE)
        if self._is_full():
            return None
        piece = bytes(data)[: TCP_ROOM - self._under_way - peer.unread()]
        if not self.is_tcp:
            network().packets += 1
            here().note("sent", self.label, piece)
            if passed:
                end = peer._place + len(peer._bytes)  # noqa: SLF001 - the other end of this one
                peer._marks.append((end, end + len(piece), hold(passed)))  # noqa: SLF001
            peer._bytes += piece  # noqa: SLF001
            peer.changed()
            return len(piece)
        seconds, cut = network().weather.stream_piece(len(piece))
        parts = (piece[:cut], piece[cut:]) if 0 < cut < len(piece) else (piece,)
        for number, part in enumerate(parts):
            self._carry(part, seconds + 0.001 * number)
        return len(piece)

    def _carry(self, data: bytes | None, seconds: float) -> None:
        """Let data arrive by TCP, in order; None is the end."""
        kernel, peer = here(), self.peer
        assert peer is not None
        self._last = max(self._last + 1, kernel.now + int(seconds * NS))
        self._under_way += len(data or b"")
        network().packets += 1
        kernel.note("sent", self.label, data)

        def arrive() -> None:
            self._under_way -= len(data or b"")
            # A machine that is gone sends nothing again of what it had kept.
            if self.owner.vanished or peer.owner.vanished or peer.peer is not self:
                return
            if data is None:
                self._is_end_heard = True
                peer._hear_end()  # noqa: SLF001 - the other end of this one
            elif not peer.is_open and not peer._is_pending():  # noqa: SLF001
                self.reset()
                return
            else:
                peer._bytes += data  # noqa: SLF001
            peer.changed()

        kernel.at(self._last, arrive)

    def _hear_end(self) -> None:
        self._has_ended = True
        peer = self.peer
        assert peer is not None
        if self._is_end_heard:  # both sides have ended
            self._state = peer._state = _ENDED  # noqa: SLF001 - the other end of this one
        else:
            peer._ended_first = True  # noqa: SLF001

    def _is_pending(self) -> bool:
        """Whether it waits to be accepted."""
        listener = network().at(self.kind, self.name)
        return listener is not None and self in listener.pending

    def send_packet(self, data: Buffer, address: Address, passed: Passed) -> int | None:
        """Send a datagram, or a packet of a connection; None if there is no room.

        Raises:
            OSError: there is nobody, or no connection.
        """
        self.raise_error()
        piece = bytes(data)
        if self._is_shut:
            fail(errno.EPIPE)
        if self.is_internet:
            return self._send_udp(piece, address)
        peer = self.peer if address is None else network().of_path(address)
        if self.is_connected_kind and not self.is_connected:
            fail(errno.ENOTCONN)
        if peer is None:
            fail(errno.ENOTCONN if address is None else errno.ECONNREFUSED)
        if peer.kind != self.kind:
            fail(errno.EPROTOTYPE)
        if not peer.is_open and not (self.is_connected_kind and not peer._has_ended):  # noqa: SLF001
            fail(errno.ECONNREFUSED)
        if not self.is_connected_kind and peer.peer not in (None, self):
            fail(errno.EPERM)
        is_full = (
            self._is_full() if self.is_connected_kind else len(peer._packets) >= _UNIX_DATAGRAM_ROOM  # noqa: SLF001
        )
        if is_full:
            peer._senders[self] = None  # noqa: SLF001
            return None
        network().packets += 1
        here().note("sent", self.label, piece)
        peer._packets.append((piece, hold(passed), self.name or None))  # noqa: SLF001
        peer.changed()
        return len(piece)

    def _send_udp(self, piece: bytes, address: Address) -> int:
        address = self.peer_name if address is None else address
        if address is None:
            fail(errno.EDESTADDRREQ)
        if len(piece) > _LONGEST_DATAGRAM:
            fail(errno.EMSGSIZE)
        if not address[1]:
            fail(errno.EINVAL)
        if self.name[1] == 0:
            self.bind((ANYWHERE, 0))
        network().packets += 1
        kernel = here()
        kernel.note("sent", self.label, piece)
        for seconds in network().weather.datagram():
            when = arrival(kernel.now, seconds, self._last)
            self._last = max(self._last, when)
            kernel.at(when, lambda: self._land(piece, address))
        return len(piece)

    def _land(self, data: bytes, address: Address) -> None:
        host, port = address
        peer = network().at(self.kind, (LOOPBACK if host == ANYWHERE else host, port))
        source = LOOPBACK if self.name[0] == ANYWHERE else self.name[0], self.name[1]
        if peer is not None and peer.owner.vanished:
            return
        if not is_local(host) and peer is None:
            return
        if peer is None or peer.peer_name not in (None, source):
            if self.peer_name is not None and self.is_open:
                self.error = errno.ECONNREFUSED  # by ICMP, to a connected socket only
                self.changed()
        elif len(peer._packets) < DATAGRAM_ROOM:  # noqa: SLF001 - another one of this kind
            peer._packets.append((data, [], source))  # noqa: SLF001
            peer._arrivals.append(EPOCH + here().now + here().wall_offset)  # noqa: SLF001
            peer.changed()

    # Receiving

    def take_bytes(self, most: int, *, peek: bool) -> tuple[bytes, Passed] | None:
        """Return what has arrived of a stream, empty at its end; None if nothing has.

        Raises:
            OSError: the connection was reset, or there is none.
        """
        if not self._bytes:
            self.raise_error()
            if self._has_ended:
                return b"", []
            if self._state in (_NEW, _LISTENING, _CONNECTING):
                fail(errno.ENOTCONN if self.is_internet else errno.EINVAL)
            return None
        if not most:
            return b"", []
        passed: Passed = []
        if self._marks and self._marks[0][0] < self._place + most:
            _, end, passed = self._marks[0]
            most = min(most, end - self._place)
        found = bytes(self._bytes[:most])
        if not peek:
            if passed:
                self._marks.popleft()
            sender = self.peer
            is_awaited = sender is not None and sender._is_full()  # noqa: SLF001 - the other end
            del self._bytes[:most]
            self._place += len(found)
            if sender is not None and is_awaited:
                sender.changed()
        return found, [] if peek else passed

    def take_packet(self, *, peek: bool) -> tuple[bytes, Passed, Address] | None:
        """Return the next packet, what was passed with it, and who sent it; None if there is none.

        Raises:
            OSError: an error is due.
        """
        self.raise_error()
        if not self._packets:
            if self.is_connected_kind and self._state == _NEW:
                fail(errno.ENOTCONN)
            if not self._has_ended:
                return None
            if not self.is_connected_kind and not self.blocking:
                raise NotSimulated("reading, with a timeout, datagrams of a socket that is shut")
            return b"", [], None
        if peek:
            data, _, sender = self._packets[0]
            return data, [], sender
        found = self._packets.popleft()
        self.arrived = self._arrivals.popleft() if self._arrivals else 0
        senders, self._senders = self._senders, {}
        for each in senders:
            each.changed()
        if self.peer is not None:
            self.peer.changed()
        return found

    # The end

    def shutdown(self, how: int) -> None:
        """As `socket.shutdown`."""
        if how not in (socket.SHUT_RD, socket.SHUT_WR, socket.SHUT_RDWR):
            fail(errno.EINVAL)
        if self.is_listening:
            if how != socket.SHUT_WR:
                self._stop_listening()
            return
        if self.is_tcp and self._state != _CONNECTED:
            fail(errno.ENOTCONN)
        if how != socket.SHUT_RD:
            self._end_sending()
        if how != socket.SHUT_WR:
            self._has_ended = True
            if not self.is_internet and self.is_connected_kind and self.peer is not None:
                self.peer._is_shut = True  # noqa: SLF001 - the other end of this one
                self.peer.changed()
        self.changed()
        if self.is_internet and self.peer_name is None:
            fail(errno.ENOTCONN)  # of a datagram socket, and yet it is shut

    def _end_sending(self) -> None:
        if self._is_shut:
            return
        self._is_shut = True
        if self.peer is None or not self.is_connected_kind:
            return
        if self.is_tcp:
            self._carry(None, network().weather.handshake())
        else:
            self.peer._has_ended = True  # noqa: SLF001 - the other end of this one
            self.peer.changed()

    def _stop_listening(self) -> None:
        self._state, self.backlog = _NEW, -1
        network().bound.pop((socket.AF_INET, self.kind, self.name), None)
        for waiting in self.pending:
            waiting._refuse()  # noqa: SLF001 - it belongs to this one
        self.pending.clear()
        self.changed()

    def _refuse(self) -> None:
        """Be a connection that nobody will accept."""
        peer = self.peer
        network().forget(self)
        if peer is None:
            return
        if self.is_tcp:
            self._send_reset()
        else:
            peer._end(errno.ECONNRESET)  # noqa: SLF001 - the other end of this one

    def _end(self, error: int) -> None:
        """Be torn off."""
        self.error = self.error or error
        self._state, self.peer = _ENDED, None
        self._has_ended = self._is_shut = True
        self.changed()

    def reset(self) -> None:
        """Tear the connection: both sides see an error."""
        here().note("reset", self.label)
        peer = self.peer
        for side in (self, peer):
            if side is not None and side.is_connected:
                side._hear_reset()  # noqa: SLF001 - the other end of this one

    def _hear_reset(self) -> None:
        self._end(errno.EPIPE if self._has_ended and not self._is_shut else errno.ECONNRESET)

    def _send_reset(self) -> None:
        """Let the other side hear, after all that was sent, that this one has torn the connection."""
        kernel, peer = here(), self.peer
        assert peer is not None
        self._last = max(self._last + 1, kernel.now + int(network().weather.handshake() * NS))
        kernel.note("reset", self.label)

        def arrive() -> None:
            if not peer.owner.vanished and peer.peer is self:
                peer._hear_reset()  # noqa: SLF001 - the other end of this one

        kernel.at(self._last, arrive)

    @override
    def released(self) -> None:
        is_torn = self.is_tcp and self.is_connected and (bool(self._bytes) or self._lingers_not())
        network().forget(
            self,
            waits=self._ended_first or (self.is_connected and not is_torn and not self._has_ended),
        )
        if self.is_listening:
            self._stop_listening()
        for _, _, passed in self._marks:
            drop(passed)
        for _, passed, _ in self._packets:
            drop(passed)
        for each in self._senders:
            each.changed()
        if self.peer is None or not self.is_connected_kind:
            return
        if self.is_tcp:
            if is_torn:
                self._send_reset()
            elif self.is_connected:
                self._end_sending()
            return
        peer = self.peer
        peer._has_ended = peer._is_shut = True  # noqa: SLF001 - the other end of this one
        if self._bytes or self._packets:
            peer.error = errno.ECONNRESET
        peer.changed()

    def _lingers_not(self) -> bool:
        value = self.options.get(_LINGER)
        return isinstance(value, bytes) and struct.unpack("ii", value) == (1, 0)

    @override
    def read(self, most: int) -> bytes:
        here().preempt()
        data, passed, _ = self._until(lambda: self.take(most, peek=False), READ)
        drop(passed)
        return data[:most]

    @override
    def write(self, data: Buffer) -> int:
        here().preempt()
        return self._until(lambda: self.send(data, None, []), WRITE)

    def _until(self, attempt: Callable[[], Found | None], events: int) -> Found:
        found = attempt()
        if found is not None:
            return found
        if not self.blocking:
            fail(errno.EAGAIN)
        return self.repeat(attempt, events)

    def repeat(self, attempt: Callable[[], Found | None], events: int) -> Found:
        """Be in a system call until `attempt` returns something; the socket stays open for so long."""
        with held((self,)):
            while (found := attempt()) is None:
                self.await_events(events, None)
        return found

    # What sockets and descriptors have in common

    def send(self, data: Buffer, address: Address, passed: Passed) -> int | None:
        """Send what there is room for; None if there is none."""
        if self.keeps_packets:
            return self.send_packet(data, address, passed)
        return self.send_stream(data, passed) if memoryview(data).nbytes else 0

    def take(self, most: int, *, peek: bool) -> tuple[bytes, Passed, Address] | None:
        """Return what has arrived, what was passed with it, and who sent it; None if there is nothing."""
        if self.keeps_packets:
            return self.take_packet(peek=peek)
        found = self.take_bytes(most, peek=peek)
        return None if found is None else (*found, None if self.is_internet else self.peer_name)


_NEW, _CONNECTING, _CONNECTED, _LISTENING, _ENDED = (
    "new",
    "connecting",
    "connected",
    "listening",
    "ended",
)


def hold(passed: Passed) -> Passed:
    """Keep files open that are on their way."""
    for each in passed:
        if isinstance(each, OpenFile):
            each.hold()
    return passed


def drop(passed: Passed) -> None:
    """Close what nobody has taken."""
    for each in passed:
        if isinstance(each, OpenFile):
            each.drop()
        else:
            _real_close(each)
