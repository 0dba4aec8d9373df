"""How peers come: they connect to a server, or they are called, again and again."""

from __future__ import annotations

import logging
import socket
import threading
from contextlib import suppress
from typing import Final

from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.front.openigtlink.bridge import Bridge
from crtk_drivers.front.openigtlink.connection import Connection

logger = logging.getLogger(__name__)

PORT: Final = 18944
"""Of OpenIGTLink."""
MOST_PEERS: Final = 16
_LOOK: Final = 0.2
"""Seconds after which a thread that waits looks whether it is to end."""
_AGAIN: Final = 1.0
"""Seconds after which a peer that is not there is called again."""
_CALL: Final = 5.0
"""Seconds in which it must answer."""


class Server:
    """Listens; bound when it is made, so that nobody comes too early. No thread before `start`.

    Args:
        bridge: what peers are connected to.
        host: address to listen at; this machine alone, unless it says otherwise.
        port: 0: any free one.

    Attributes:
        port: in use.

    Raises:
        ConnectionFailed: the port is in use.
    """

    def __init__(self, bridge: Bridge, host: str = "127.0.0.1", port: int = PORT) -> None:
        self._bridge = bridge
        self._stopping = threading.Event()
        try:
            self._socket = socket.create_server((host, port))
        except OSError as error:
            raise ConnectionFailed(
                f"cannot listen: {error.strerror or error}",
                where=f"{host}:{port}",
                remedy="Is another server running? Give another port.",
            ) from error
        self._socket.settimeout(_LOOK)
        self.port = int(self._socket.getsockname()[1])
        self._thread = threading.Thread(target=self._accept, name="igtl server", daemon=True)

    def start(self) -> None:
        """Begin to accept."""
        self._thread.start()

    def close(self) -> None:
        """Accept no more; who is connected stays. May be called twice."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self._socket.close()

    def _accept(self) -> None:
        while not self._stopping.is_set():
            try:
                peer, (host, port, *_) = self._socket.accept()
            except TimeoutError:
                continue
            except OSError as error:  # that peer has gone already, or no descriptor is left
                logger.warning("a peer cannot be accepted: %s", error.strerror or error)
                self._stopping.wait(_LOOK)
                continue
            where = f"{host}:{port}"
            if len(self._bridge.connections) >= MOST_PEERS:
                logger.warning("%s is sent away: %d are connected", where, MOST_PEERS)
                peer.close()
                continue
            _joined(self._bridge, peer, where)


class Caller:
    """Connects to a server, and again when that is gone. No thread before `start`.

    Args:
        bridge: what the peer is connected to.
        host, port: of the server.
    """

    def __init__(self, bridge: Bridge, host: str, port: int = PORT) -> None:
        self._bridge = bridge
        self._address = host, port
        self._stopping = threading.Event()
        self._connection: Connection | None = None
        self._thread = threading.Thread(target=self._call, name="igtl client", daemon=True)

    def start(self) -> None:
        """Begin to call."""
        self._thread.start()

    def close(self) -> None:
        """Call no more, and let the peer go. May be called twice."""
        self._stopping.set()
        connection = self._connection
        if connection is not None:
            connection.end()
        if self._thread.is_alive():
            self._thread.join(_CALL + 1.0)

    def _call(self) -> None:
        is_told = False
        while not self._stopping.is_set():
            peer = None
            with suppress(OSError):
                peer = socket.create_connection(self._address, _CALL)
            if peer is None:
                if not is_told:
                    logger.info("%s:%d is not there; it is called again", *self._address)
                is_told = True
                self._stopping.wait(_AGAIN)
                continue
            is_told = False
            where = "{}:{}".format(*self._address)
            self._connection = connection = _joined(self._bridge, peer, where)
            while connection is not None and not connection.wait(_LOOK):
                if self._stopping.is_set():
                    connection.end()
            self._stopping.wait(_AGAIN)


def _joined(bridge: Bridge, peer: socket.socket, where: str) -> Connection | None:
    """Return the connection of a peer; None if there can be none: others may come all the same."""
    connection = None
    try:
        connection = Connection(peer, where, bridge, bridge.version)
        bridge.join(connection)
    except Exception:
        logger.exception("%s cannot be served", where)
        if connection is not None:
            connection.end()
            bridge.left(connection)
        peer.close()
        return None
    return connection
