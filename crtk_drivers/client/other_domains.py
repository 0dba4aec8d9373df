"""Which ROS domains other machines use, by what they announce: nothing is sent.

Every participant of DDS announces itself by multicast, at a port that follows from its domain; Fast DDS does
so every 3 s. Who was told not to use multicast, or to stay on its machine, is not heard. Source: DDSI-RTPS
2.5, sections 8.3.3 (header) and 9.6.1 (ports), and the vendor ids at dds-foundation.org.
"""

from __future__ import annotations

import selectors
import socket
import struct
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Final

from crtk_drivers.config.variables import LAST_DOMAIN

__all__ = ["Announced", "announced"]

LISTEN_TIME: Final = 3.5
"""Seconds: a period of Fast DDS, and some more."""

_GROUP: Final = "239.255.0.1"
_PORT: Final = 7400
_PORTS_PER_DOMAIN: Final = 250
_HEADER: Final = b"RTPS"
_HEADER_SIZE: Final = 20
_VENDORS: Final = {
    b"\x01\x01": "RTI Connext",
    b"\x01\x0f": "Fast DDS",
    b"\x01\x10": "Cyclone DDS",
}


@dataclass(frozen=True, slots=True, order=True)
class Announced:
    """ROS 2, or another program with DDS, on another machine.

    Attributes:
        domain: of ROS.
        address: of the machine.
        vendor: of its DDS; empty: none that ROS 2 has.
    """

    domain: int
    address: str
    vendor: str


def announced(seconds: float = LISTEN_TIME) -> tuple[Announced, ...]:
    """Listen for so long, and return what other machines announce, in the order of the domains."""
    found: set[Announced] = set()
    deadline = time.monotonic() + seconds
    with ExitStack() as stack, selectors.DefaultSelector() as selector:
        for domain, listener in _listeners(range(LAST_DOMAIN + 1)):
            selector.register(stack.enter_context(listener), selectors.EVENT_READ, domain)
        while (left := deadline - time.monotonic()) > 0.0:
            for key, _ in selector.select(left):
                assert isinstance(key.fileobj, socket.socket)
                with suppress(OSError):
                    data, (address, _) = key.fileobj.recvfrom(65536)
                    if len(data) >= _HEADER_SIZE and data.startswith(_HEADER):
                        found.add(Announced(key.data, address, _VENDORS.get(data[6:8], "")))
    own = {address for address in {each.address for each in found} if _is_own(address)}
    return tuple(sorted(each for each in found if each.address not in own))


def _listeners(domains: Iterable[int]) -> Iterator[tuple[int, socket.socket]]:
    """Yield a socket for each domain that can be heard, beside the participants of this machine."""
    interfaces = [index for index, _ in socket.if_nameindex()]
    group = socket.inet_aton(_GROUP)
    for domain in domains:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            listener.setblocking(False)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((_GROUP, _PORT + _PORTS_PER_DOMAIN * domain))
        except OSError:
            listener.close()
            continue
        for index in interfaces:
            with suppress(OSError):  # it has no address, or does no multicast
                request = struct.pack("=4s4si", group, bytes(4), index)
                listener.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
        yield domain, listener


def _is_own(address: str) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        try:
            own.bind((address, 0))
        except OSError:
            return False
        return True
