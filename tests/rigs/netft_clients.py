"""Clients of a NetFT sensor box that share no code with driver or simulator, and a box without sockets."""

from __future__ import annotations

import re
import socket
import struct
import urllib.request
from typing import Any, NamedTuple, Self

from crtk_sim_backends.netft.box import Box
from crtk_sim_backends.netft.config import SimConfig
from rigs.waiting import LONG

FREE_PORTS = {"rdt_port": 0, "tcp_port": 0, "http_port": 0}


class Record(NamedTuple):
    """One record."""

    rdt: int
    ft: int
    status: int
    counts: tuple[int, ...]


def records(datagram: bytes) -> list[Record]:
    """Return the records of a datagram."""
    return [Record(r[0], r[1], r[2], r[3:]) for r in struct.iter_unpack(">III6i", datagram)]


def request(command: int, count: int = 0) -> bytes:
    """Return an RDT request."""
    return struct.pack(">HHI", 0x1234, command, count)


class RdtClient:
    """One UDP socket."""

    def __init__(self, sim: Any) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._socket.bind((sim.host, 0))
        self._socket.settimeout(LONG)
        self._to = sim.host, sim.ports["rdt"]
        self.address = self._socket.getsockname()

    def send(self, data: bytes) -> None:
        """Send a datagram."""
        self._socket.sendto(data, self._to)

    def ask(self, command: int, count: int = 0) -> None:
        """Send a request."""
        self.send(request(command, count))

    def receive(self) -> list[Record]:
        """Return the records of the next datagram."""
        return records(self.datagram())

    def datagram(self) -> bytes:
        """Return the next datagram."""
        return self._socket.recv(65536)

    def take(self, count: int) -> list[Record]:
        """Return so many records."""
        found: list[Record] = []
        while len(found) < count:
            found += self.receive()
        return found

    def until_silent(self, seconds: float = 0.1) -> list[Record]:
        """Return all records until nothing comes for a while."""
        found: list[Record] = []
        self._socket.settimeout(seconds)
        try:
            while True:
                found += self.receive()
        except TimeoutError:
            return found
        finally:
            self._socket.settimeout(LONG)

    def silent(self, seconds: float = 0.1) -> bool:
        """Whether nothing comes for a while."""
        return not self.until_silent(seconds)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()


def page(sim: Any, path: str) -> str:
    """Return a page of the web server."""
    url = f"http://{sim.host}:{sim.ports['http']}/{path}"
    with urllib.request.urlopen(url, timeout=LONG) as reply:
        text: str = reply.read().decode()
    return text


def tags(text: str) -> dict[str, str]:
    """Return the tags of an XML page; each must be there once."""
    found = re.findall(r"<(\w+)>([^<]*)</\1>", text)
    names = [name for name, _ in found]
    assert len(names) == len(set(names))
    return dict(found)


def ask_tcp(sim: Any, *requests: bytes) -> list[bytes]:
    """Send 20-byte requests one after the other and return the answers."""
    answers = []
    sizes = {0: 16, 1: 24}
    with socket.create_connection((sim.host, sim.ports["tcp"]), LONG) as peer:
        for data in requests:
            peer.sendall(data)
            answers.append(_exactly(peer, sizes.get(data[0], 4)))
    return answers


def _exactly(peer: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = peer.recv(size - len(data))
        assert piece, "closed"
        data += piece
    return data


class VirtualBox:
    """A box without sockets, whose time passes as a test wants."""

    def __init__(self, **options: Any) -> None:
        self.now = 0.0
        self.box = Box(SimConfig(**options), self.now)
        self.client = ("127.0.0.1", 1)

    def ask(self, command: int, count: int = 0, client: int = 1) -> None:
        """Send an RDT request."""
        self.box.request(request(command, count), ("127.0.0.1", client), self.now)
        self.box.settle(self.now)

    def write(self, page: str, **values: Any) -> bool:
        """Call a CGI page."""
        found = self.box.write_page(page, [(k, str(v)) for k, v in values.items()])
        self.box.settle(self.now)
        return found

    def run(self, seconds: float) -> list[Record]:
        """Let time pass, and return what was sent."""
        return [record for data in self.datagrams(seconds) for record in records(data)]

    def datagrams(self, seconds: float) -> list[bytes]:
        """Let time pass, and return the datagrams."""
        self.now += seconds
        return self.box.datagrams(self.now)

    @property
    def counts(self) -> tuple[int, ...]:
        """The newest measurement."""
        return self.box.sensor.measurement(self.now).counts

    @property
    def status(self) -> int:
        """Its status word."""
        return self.box.sensor.measurement(self.now).status
