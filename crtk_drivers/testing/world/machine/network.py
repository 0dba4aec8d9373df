"""The network of a world: who has which address, and what the weather does to what is sent."""

from __future__ import annotations

import _socket as socket
import errno
import os
from typing import Any, Final, Generic, Protocol, TypeVar

from crtk_drivers.testing.world.machine.files import fail
from crtk_drivers.testing.world.machine.kernel import NS, here

Address = Any
"""As Python's sockets have it: host and port, or a path; bytes for an abstract name."""

ANYWHERE: Final = "0.0.0.0"
LOOPBACK: Final = "127.0.0.1"
REUSE: Final = (socket.SOL_SOCKET, socket.SO_REUSEADDR)
_TIME_WAIT: Final = 60 * NS
"""For so long, the port of a connection that this side has ended first is in use."""


_KEEPS_ORDER: Final = NS // 1000
"""ns within which datagrams keep their order; what is later than this is overtaken."""


def arrival(now: int, seconds: float, last: int) -> int:
    """Return when a datagram arrives (ns) that takes so many s, behind one that arrives at `last`."""
    when = now + int(seconds * NS)
    return last + 1 if when < last < when + _KEEPS_ORDER else when


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


class Bound(Protocol):
    """A socket, as the network sees it."""

    name: Address
    backlog: int
    options: dict[tuple[int, int], Any]

    @property
    def is_tcp(self) -> bool:
        """Whether it keeps the order."""


Socket = TypeVar("Socket", bound=Bound)


class Network(Generic[Socket]):
    """Addresses of a world, and its weather.

    Attributes:
        bound: who has a path or an abstract name, and who receives datagrams at an address or listens there.
        streams: one end of each TCP connection, for a fault to choose from.
        packets: how many were sent.
    """

    def __init__(self, weather: Weather) -> None:
        self.weather = weather
        self.bound: dict[tuple[int, int, Any], Socket] = {}
        self.streams: list[Socket] = []
        self.packets = 0
        self._ports: dict[Socket, None] = {}  # all TCP sockets that have one
        self._ended: list[
            tuple[int, Address]
        ] = []  # until when a port is in use after a connection
        self._port = 40_000

    def free_port(self) -> int:
        """Return a port that nobody has had."""
        self._port += 1
        return self._port

    def at(self, kind: int, address: Address) -> Socket | None:
        """Return who listens at an address of the internet, or receives datagrams there."""
        found = self.bound.get((socket.AF_INET, kind, address))
        return found or self.bound.get((socket.AF_INET, kind, (ANYWHERE, address[1])))

    def of_path(self, address: Address) -> Socket | None:
        """Return which Unix socket has a name.

        Raises:
            OSError: there is no such file (ENOENT).
        """
        return self.bound.get((socket.AF_UNIX, 0, unix_key(address)))

    def claim(self, endpoint: Socket, address: Address) -> None:
        """Give a socket an address of the internet.

        Raises:
            OSError: another one has it (EADDRINUSE).
        """
        host, port = address
        may_share = bool(endpoint.options.get(REUSE))
        if endpoint.is_tcp:
            self._ended = [each for each in self._ended if each[0] > here().now]
            taken = [name for _, name in self._ended] if not may_share else []
            taken += [
                each.name
                for each in self._ports
                if not (may_share and each.options.get(REUSE) and each.backlog < 0)
            ]
        else:
            taken = [
                name
                for (family, kind, name), each in self.bound.items()
                if (family, kind) == (socket.AF_INET, socket.SOCK_DGRAM)
                and not (may_share and each.options.get(REUSE))
            ]
        for name in taken:
            if name[1] == port and (name[0] == host or ANYWHERE in (host, name[0])):
                fail(errno.EADDRINUSE)
        self.have_port(endpoint, address)

    def have_port(self, endpoint: Socket, address: Address) -> None:
        """Note the address of a socket of the internet."""
        endpoint.name = address
        if endpoint.is_tcp:
            self._ports[endpoint] = None
        else:
            self.bound[socket.AF_INET, socket.SOCK_DGRAM, address] = endpoint

    def forget(self, endpoint: Socket, *, waits: bool = False) -> None:
        """Free the addresses of a socket; that of a connection may be in use for a time."""
        for key in [key for key, each in self.bound.items() if each is endpoint]:
            del self.bound[key]
        if endpoint in self._ports:
            del self._ports[endpoint]
            if waits:
                self._ended.append((here().now + _TIME_WAIT, endpoint.name))
        if endpoint in self.streams:
            self.streams.remove(endpoint)


def unix_key(address: Address) -> Any:
    """Return by what a Unix socket is found: its abstract name, or its file."""
    if isinstance(address, bytes):
        return address
    status = os.stat(address)
    return status.st_dev, status.st_ino


def is_local(host: str) -> bool:
    """Whether an address is one of this machine."""
    return host == ANYWHERE or host.startswith("127.")
