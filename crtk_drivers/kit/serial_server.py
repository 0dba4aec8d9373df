"""A serial line behind a TCP port: ``socket://host:port``, as pyserial names it."""

from __future__ import annotations

import errno
import select
import socket
import time
from typing import Annotated, Any, Final, NamedTuple
from urllib.parse import urlsplit

from pydantic import AfterValidator

from crtk_drivers.kit.ready import await_connection, is_ready
from crtk_drivers.kit.robot_ports import script_port

__all__ = ["OPEN_TIMEOUT", "PortName", "ServerAddress", "connect", "parse_address"]

SCHEME: Final = "socket"

GIVE_UP: Final = 0.5
"""Seconds after which bytes that the network did not deliver are dropped with the connection: goals that come
late would be carried out late."""

OPEN_TIMEOUT: Final = 3.0
"""Seconds for the connection to be made."""


def _checked(name: str) -> str:
    parse_address(name)
    return name


class ServerAddress(NamedTuple):
    """Where the server of a serial line listens."""

    host: str
    port: int


def parse_address(name: str) -> ServerAddress | None:
    """Return the server that a port's name means, None if it is the name of a device file.

    Raises:
        ValueError: it is a URL, and none of such a server.
    """
    if "://" not in name:
        return None
    url = urlsplit(name)
    if url.scheme != SCHEME:
        raise ValueError(
            f"{url.scheme}:// is not known: a port is a device file, or {SCHEME}://HOST:PORT"
        )
    if not url.hostname or not url.port or url.path not in ("", "/") or url.query:
        raise ValueError(f"{name!r} is not {SCHEME}://HOST:PORT")
    if danger := script_port(url.port):
        raise ValueError(f"{name!r} is no serial line: {danger}")
    return ServerAddress(url.hostname, url.port)


PortName = Annotated[str, AfterValidator(_checked)]
"""Of a configuration: a device file, or ``socket://host:port``."""


def connect(address: ServerAddress, timeout: float = OPEN_TIMEOUT) -> socket.socket:
    """Return a connection that does not block, delays nothing, and ends rather than deliver late.

    Raises:
        OSError: there is none by the end of `timeout`, or it was given up.
    """
    deadline = time.monotonic() + timeout
    failure = OSError(errno.EADDRNOTAVAIL, "it has no address")
    for family, kind, protocol, _, place in socket.getaddrinfo(*address, type=socket.SOCK_STREAM):
        made = socket.socket(family, kind, protocol)
        try:
            _connect(made, place, deadline)
        except OSError as error:
            made.close()
            failure = error
            if error.errno in (errno.ECANCELED, errno.ETIMEDOUT):
                break
        else:
            return made
    raise failure


def _connect(made: socket.socket, place: Any, deadline: float) -> None:
    poll = select.poll()
    poll.register(made, select.POLLOUT)
    await_connection(made, place, lambda: is_ready(poll, deadline))
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000 * GIVE_UP))
