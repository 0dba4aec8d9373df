"""A simulated bus offered by TCP, as a serial device server on the network does (pyserial: ``socket://``)."""

from __future__ import annotations

import contextlib
import logging
import socket
from typing import Final

log = logging.getLogger(__name__)

_READ_SIZE: Final = 65536


class TcpDoor:
    """One port, for one client at a time.

    Args:
        listener: bound, and listening.
    """

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        self._client: socket.socket | None = None

    @property
    def listener(self) -> int:
        """File descriptor that becomes readable when somebody wants to come in."""
        return self._listener.fileno()

    @property
    def client(self) -> int | None:
        """File descriptor of the client, None if there is none."""
        return None if self._client is None else self._client.fileno()

    @property
    def port(self) -> int:
        """TCP port."""
        return int(self._listener.getsockname()[1])

    def accept(self, *, welcome: bool) -> None:
        """Let a client in; another one is sent away, as is everybody who is not welcome."""
        try:
            client, _ = self._listener.accept()
        except OSError as error:
            log.info("a client of a bus was gone at once: %s", error)
            return
        if self._has_left():
            self.leave()
        if self._client is not None or not welcome:
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client

    def _has_left(self) -> bool:
        """Whether there is a client that has hung up, and of which nothing is to be read."""
        if self._client is None:
            return False
        try:
            return not self._client.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            return True

    def read(self) -> bytes:
        """What the client has sent; nothing if there is nothing. A client that has left is forgotten."""
        if self._client is None:
            return b""
        try:
            data = self._client.recv(_READ_SIZE)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError:
            data = b""
        if not data:
            self.leave()
        return data

    def write(self, data: bytes) -> int:
        """Send to the client: how many bytes the system has taken."""
        if self._client is not None:
            with contextlib.suppress(OSError):
                return self._client.send(data)
        return 0

    def leave(self) -> None:
        """Send the client away. Safe to repeat."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def close(self) -> None:
        """Send the client away, and let nobody in any more."""
        self.leave()
        self._listener.close()
