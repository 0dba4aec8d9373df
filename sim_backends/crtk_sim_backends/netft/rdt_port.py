"""The UDP port of the box, and what happens to datagrams on their way."""

from __future__ import annotations

import errno
import logging
import socket
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from crtk_sim_backends.faults import Fault
from crtk_sim_backends.kit import ALL_PORTS
from crtk_sim_backends.kit.datagrams import STREAM, DatagramHook, FaultyWay
from crtk_sim_backends.netft.rdt import Address
from crtk_sim_backends.process import AddressInUseError, SimStartError

log = logging.getLogger(__name__)

NAME: Final = "rdt"

_LONGEST_REQUEST: Final = 64
_STRANGE_RECORD: Final = struct.pack(">III6i", 123, 456, 0, *[99_000_000] * 6)


@dataclass
class Traffic:
    """Datagrams that went out, and that the system did not take."""

    datagrams: int = 0
    unsent: int = 0


class RdtPort:
    """The port, with two more sockets for somebody else on the network.

    Args:
        host: address of the box.
        number: of the port, 0 for any free one.

    Raises:
        AddressInUseError: when another process holds it.
        SimStartError: when the address cannot be bound at all.
    """

    def __init__(self, host: str, number: int) -> None:
        self._socket: socket.socket | None = _open(host, number)
        self.host = host
        self.number: int = self._socket.getsockname()[1]
        self.traffic = Traffic()
        self._stranger = _open(host, 0)
        self._other_client = _open(host, 0)
        self._faults: set[str] = set()
        self._way = FaultyWay()
        self._to: Address | None = None

    @property
    def fd(self) -> int:
        """File descriptor for `select`, -1 while the port is closed."""
        return -1 if self._socket is None else self._socket.fileno()

    @property
    def other_client(self) -> Address:
        """Address of another client, which throws away what it gets."""
        address: Address = self._other_client.getsockname()
        return address

    @property
    def is_plain(self) -> bool:
        """Whether datagrams go out just as they are."""
        return self._socket is not None and self._way.is_plain

    def send(self, datagrams: Iterable[bytes], to: Address) -> None:
        """Send the datagrams of a stream, or what the faults make of them."""
        self._to = to
        if self._socket is None:
            return
        for data in self._way.through(datagrams):
            self._send(self._socket, data, to)

    def plain_sender(self, to: Address) -> Callable[[memoryview], object]:
        """Return what sends one datagram as it is."""
        peer = self._socket
        assert peer is not None
        return lambda data: self._send(peer, data, to)

    def receive(self) -> Iterator[tuple[bytes, Address]]:
        """Yield what has come and from whom, unless a fault keeps it from the box."""
        while self._socket is not None:
            try:
                data, sender = self._socket.recvfrom(_LONGEST_REQUEST)
            except BlockingIOError:
                return
            except OSError as error:
                log.debug("RDT: %s", error)
                return
            if "deaf" not in self._faults:
                yield data, sender

    def begin(self, fault: Fault) -> None:
        """Let a fault begin; those that do not concern the port do nothing."""
        self._faults.add(fault.kind)
        if fault.kind in STREAM:
            self._way.begin(fault.kind, STREAM[fault.kind](fault.parameters))
        elif fault.kind == "foreign":
            self._way.begin(fault.kind, self._strange(fault.parameters["every"]))
        elif fault.kind == "closed" and fault.parameters["port"] in (NAME, ALL_PORTS):
            self._close_port()

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._faults.discard(fault.kind)
        self._way.end(fault.kind)
        if self._to is not None:
            self.send((), self._to)  # what is late by it: not to be taken for one of a later stream
        if fault.kind == "closed" and self._socket is None:
            self._socket = _open(self.host, self.number)

    def close(self) -> None:
        """Close every socket."""
        self._close_port()
        self._stranger.close()
        self._other_client.close()

    def _close_port(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, peer: socket.socket, data: bytes | memoryview, to: Address) -> None:
        try:
            peer.sendto(data, to)
        except OSError as error:
            self.traffic.unsent += 1
            log.debug("a datagram to %s was not sent: %s", to, error)
        else:
            self.traffic.datagrams += 1

    def _strange(self, every: int) -> DatagramHook:
        seen = 0

        def hook(data: bytes) -> list[bytes]:
            nonlocal seen
            seen += 1
            if seen % every == 0 and self._to is not None:
                self._send(self._stranger, _STRANGE_RECORD, self._to)
            return [data]

        return hook


def _open(host: str, number: int) -> socket.socket:
    peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        peer.bind((host, number))
    except OSError as error:
        peer.close()
        if error.errno == errno.EADDRINUSE:
            raise AddressInUseError(
                f"cannot bind the rdt port {host}:{number} (UDP): it is in use, perhaps by another "
                f"simulator; `ss -lunp 'sport = :{number}'` names the process. Stop it, or choose "
                "another 127.x.y.z address."
            ) from error
        raise SimStartError(
            f"cannot bind the rdt port {host}:{number} (UDP): {error.strerror}; choose an address of "
            "this machine, such as 127.0.0.2"
        ) from error
    peer.setblocking(False)
    return peer
