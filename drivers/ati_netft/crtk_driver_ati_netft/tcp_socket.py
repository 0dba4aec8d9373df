"""A TCP connection that is waited for in small pieces, so that whoever shuts down need not wait as well."""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from collections.abc import Callable
from typing import Final

_PIECE: Final = 0.05


class TcpSocket:
    """One connection. What fails, times out or is aborted raises OSError.

    Args:
        aborted: asked every now and then while something is waited for: whether to give up.
        clock: monotonic seconds.
    """

    def __init__(
        self, aborted: Callable[[], bool], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._aborted = aborted
        self._clock = clock
        self._socket: socket.socket | None = None

    def connect(self, host: str, port: int, deadline: float) -> None:
        """Connect before the monotonic `deadline`."""
        self.close()
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, socket.AF_INET, socket.SOCK_STREAM
        )[0]
        peer = socket.socket(family, kind, protocol)
        self._socket = peer
        peer.setblocking(False)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        code = peer.connect_ex(address)
        if code == errno.EINPROGRESS:
            if not self.wait(select.POLLOUT, deadline):
                raise TimeoutError(errno.ETIMEDOUT, "no connection in time")
            code = peer.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            raise OSError(code, os.strerror(code))

    def wait(self, events: int, deadline: float) -> bool:
        """Wait for `select.POLLIN` or `select.POLLOUT`; return whether it came before the deadline."""
        poll = select.poll()
        poll.register(self.peer, events)
        while not self._aborted():
            left = deadline - self._clock()
            if poll.poll(max(0.0, min(left, _PIECE)) * 1000.0):
                return True
            if left <= 0.0:
                return False
        raise OSError(errno.ECANCELED, "given up: the driver is being shut down")

    @property
    def peer(self) -> socket.socket:
        """The socket, non-blocking."""
        if self._socket is None:
            raise OSError(errno.ENOTCONN, "it is closed")
        return self._socket

    def close(self) -> None:
        """Disconnect. May be called twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
