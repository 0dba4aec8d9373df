"""The wire between a simulator and its clients, and the ways in which a wire misbehaves.

A wire hook is one function, ``hook(direction, data, now) -> [(delay, data), ...]``: it sees every
piece of data that crosses a connection and says what really arrives, and how many seconds later.
Dropping, splitting, corrupting and delaying are each a few lines; hooks are chained with
:func:`chain`.
"""

from __future__ import annotations

import random
import socket
from collections import deque
from collections.abc import Callable, Iterable
from enum import Enum
from typing import Final, TypeAlias, TypeVar


class Direction(Enum):
    """Which way data crosses the wire, seen from the simulator."""

    IN = "in"
    OUT = "out"


Pieces: TypeAlias = list[tuple[float, bytes]]
WireHook: TypeAlias = Callable[[Direction, bytes, float], Pieces]
WayT = TypeVar("WayT")


def split(size: int = 1, spacing: float = 0.0) -> WireHook:
    """Cut the data into pieces of `size` bytes, each sent alone, `spacing` seconds apart."""

    def hook(direction: Direction, data: bytes, now: float) -> Pieces:
        starts = range(0, len(data), size)
        return [(n * spacing, data[start : start + size]) for n, start in enumerate(starts)]

    return hook


def delay(seconds: float) -> WireHook:
    """Let everything arrive `seconds` later."""

    def hook(direction: Direction, data: bytes, now: float) -> Pieces:
        return [(seconds, data)]

    return hook


def coalesce(seconds: float) -> WireHook:
    """Hold the data back and let all of it arrive at once, every `seconds`."""

    def hook(direction: Direction, data: bytes, now: float) -> Pieces:
        return [(seconds - now % seconds, data)]

    return hook


def corrupt(every: int = 10, seed: int = 0) -> WireHook:
    """Change one random byte in every `every`-th piece of data, the same ones for one `seed`."""
    generator = random.Random(seed)
    seen = 0

    def hook(direction: Direction, data: bytes, now: float) -> Pieces:
        nonlocal seen
        seen += 1
        if seen % every or not data:
            return [(0.0, data)]
        index = generator.randrange(len(data))
        changed = bytearray(data)
        changed[index] ^= generator.randrange(1, 256)
        return [(0.0, bytes(changed))]

    return hook


def drop(every: int = 1) -> WireHook:
    """Lose every `every`-th piece of data (1: all of it)."""
    seen = 0

    def hook(direction: Direction, data: bytes, now: float) -> Pieces:
        nonlocal seen
        seen += 1
        return [] if seen % every == 0 else [(0.0, data)]

    return hook


def one_way(hook: WireHook, only: Direction) -> WireHook:
    """Apply `hook` to one direction and leave the other alone."""

    def limited(direction: Direction, data: bytes, now: float) -> Pieces:
        return hook(direction, data, now) if direction is only else [(0.0, data)]

    return limited


def chain(
    hooks: Iterable[Callable[[WayT, bytes, float], Pieces]],
) -> Callable[[WayT, bytes, float], Pieces] | None:
    """Pass the data through all `hooks` in turn, each with who sends it; None when there are none."""
    stages = list(hooks)
    if not stages:
        return None

    def chained(way: WayT, data: bytes, now: float) -> Pieces:
        pieces: Pieces = [(0.0, data)]
        for stage in stages:
            pieces = [
                (before + after, piece)
                for before, whole in pieces
                for after, piece in stage(way, whole, now + before)
            ]
        return pieces

    return chained


class Lane:
    """Data under way in one direction: order is kept, whatever the delays are.

    Args:
        joins: whether pieces that arrive at the same time become one, as bytes do and datagrams do not.
    """

    def __init__(self, *, joins: bool = True) -> None:
        self._joins = joins
        self._pieces: deque[tuple[float, bytes]] = deque()
        self.size = 0  # bytes

    def __len__(self) -> int:
        return len(self._pieces)

    @property
    def next_due(self) -> float:
        """When the next piece arrives; there is one."""
        return self._pieces[0][0]

    def put(self, pieces: Pieces, now: float) -> None:
        """Take pieces, each with the seconds until it arrives."""
        self.size += sum(len(data) for _, data in pieces)
        if self._joins and pieces and self._pieces:
            waiting, held = self._pieces[-1]
            if waiting > now and waiting >= now + pieces[0][0]:
                self._pieces[-1] = waiting, held + pieces[0][1]  # they arrive together
                pieces = pieces[1:]
        earliest = self._pieces[-1][0] if self._pieces else now
        for seconds, data in pieces:
            earliest = max(earliest, now + seconds)
            self._pieces.append((earliest, data))

    def take_due(self, now: float) -> list[bytes]:
        """Return the pieces whose time has come."""
        due = []
        while self._pieces and self._pieces[0][0] <= now:
            due.append(self._pieces.popleft()[1])
            self.size -= len(due[-1])
        return due


class Connection:
    """One accepted TCP connection: never blocks, passes everything through the hook of its port.

    `send` keeps what the peer does not take; `send_fresh` drops whole packages instead, for
    streams in which only the newest counts. The owner calls `flush` regularly, and `close` when
    `closed` or `peer_closed` tell that the connection has come to its end.
    """

    RECEIVE_SIZE: Final = 65536
    RECEIVED_LIMIT: Final = 1 << 18  # bytes under way to us; then the peer has to wait
    PIECES_UNDER_WAY: Final = 10_000  # then the peer has to wait, or packages for it are dropped

    def __init__(self, sock: socket.socket, limit: int, *, send_buffer: int | None = None) -> None:
        sock.setblocking(False)
        if sock.family == socket.AF_INET:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if send_buffer is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, send_buffer)
        self._socket = sock
        self._limit = limit
        self._backlog = bytearray()
        self._incoming = Lane()
        self._outgoing = Lane()
        self._blocked_since: float | None = None
        self.hook: WireHook | None = None
        self.closed = False
        self.peer_closed = False
        self.bytes_in = 0
        self.bytes_out = 0
        self.dropped = 0  # packages that a slow peer did not get

    def fileno(self) -> int:
        """File descriptor for `select`; -1 once closed."""
        return self._socket.fileno()

    @property
    def ended(self) -> bool:
        """Whether this side or the peer has closed it, so that nothing more can be read."""
        return self.closed or self.peer_closed

    @property
    def blocked(self) -> bool:
        """Whether the peer has left data untaken."""
        return bool(self._backlog)

    def blocked_for(self, now: float) -> float:
        """Seconds since the peer last took anything, 0.0 when nothing waits."""
        return 0.0 if self._blocked_since is None else now - self._blocked_since

    def read(self, now: float) -> None:
        """Take what the socket has; notes it in `peer_closed` when the peer has closed."""
        incoming = self._incoming
        if incoming.size > self.RECEIVED_LIMIT or len(incoming) > self.PIECES_UNDER_WAY:
            return
        try:
            data = self._socket.recv(self.RECEIVE_SIZE)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data:
            self.peer_closed = True
            return
        self.bytes_in += len(data)
        self._incoming.put(self.hook(Direction.IN, data, now) if self.hook else [(0.0, data)], now)

    @property
    def has_input(self) -> bool:
        """Whether received data waits for its time, or to be taken."""
        return bool(self._incoming)

    @property
    def has_output(self) -> bool:
        """Whether data to send waits for its time, or for the peer."""
        return bool(self._backlog) or bool(self._outgoing)

    def take(self, now: float) -> list[bytes]:
        """Pieces of received data whose time has come."""
        return self._incoming.take_due(now) if self._incoming else []

    def send(self, data: bytes, now: float) -> None:
        """Send `data`, keeping what the peer does not take; `closed` when that exceeds the limit."""
        if self.closed or not data:
            return
        if self.hook is None and not self._outgoing:
            self._transmit(data, now)
        else:
            pieces = self.hook(Direction.OUT, data, now) if self.hook else [(0.0, data)]
            self._outgoing.put(pieces, now)
            self.flush(now)
        if len(self._backlog) + self._outgoing.size > self._limit:
            self.closed = True

    def send_fresh(self, package: bytes, now: float) -> bool:
        """Send a whole package, or drop it when the peer still owes the last. True when sent."""
        if self._backlog:
            self.flush(now)
        if self._backlog or self.closed or len(self._outgoing) > self.PIECES_UNDER_WAY:
            self.dropped += 1
            return False
        self.send(package, now)
        return True

    def flush(self, now: float) -> None:
        """Send what is due and what the peer did not take before."""
        if self.closed:
            return
        if self._backlog:
            self._drain(now)
        for piece in self._outgoing.take_due(now) if self._outgoing else ():
            self._transmit(piece, now)

    def _transmit(self, data: bytes, now: float) -> None:
        if self._backlog:
            self._backlog += data
            return
        sent = self._put(data)
        if sent < len(data):
            self._backlog += data[sent:]
            self._blocked_since = now

    def _drain(self, now: float) -> None:
        """Send what the peer did not take before."""
        sent = self._put(self._backlog)
        del self._backlog[:sent]
        if not self._backlog:
            self._blocked_since = None
        elif sent:
            self._blocked_since = now

    def _put(self, data: bytes | bytearray) -> int:
        """Give data to the kernel; how many bytes it took, and `closed` when that failed."""
        try:
            sent = self._socket.send(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            self.closed = True
            return 0
        self.bytes_out += sent
        return sent

    def close(self) -> None:
        """Close the socket; safe to repeat."""
        self.closed = True
        self._socket.close()
