"""A CAN bus through the relay: the driver's end speaks socketcand, the other is an adapter of any kind.

Source of the protocol: doc/protocol.md of github.com/linux-can/socketcand, raw mode.
"""

from __future__ import annotations

import contextlib
import re
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import can

from crtk_drivers.errors import ConnectionFailed

CHUNK: Final = 65536

LOOK: Final = 0.1
"""Seconds after which the thread that hears the adapter looks whether it is to end."""

QUIET: Final = 0.25
"""Seconds after it has opened the bus in which a client gets no frame, unless it has sent something:
python-can fails to open where one follows at once."""

MOST_WAITING: Final = 1 << 20
"""Bytes that a client has not taken; beyond that frames are lost to it."""

RESET: Final = struct.pack("ii", 1, 0)
"""SO_LINGER: closing sends RST."""

_COMMAND: Final = re.compile(rb"<([^<>]*)>")


class CanLine:
    """One bus. What does not pass is lost, as on a wire that is cut.

    Args:
        bus: arguments with which python-can opens the adapter.
        host: where the driver's end listens, at a port of its own.
        selector: tells what can be read, and has a callable of its events for each.
        passes: whether what goes to the bus (True), or comes from it, passes now.

    Attributes:
        port: of the driver's end; it stays when that is closed and opened.

    Raises:
        ConnectionFailed: the adapter cannot be opened.
        OSError: it cannot listen.
    """

    def __init__(
        self,
        bus: Mapping[str, Any],
        host: str,
        selector: selectors.BaseSelector,
        passes: Callable[[bool], bool],
    ) -> None:
        self._host = host
        self._selector = selector
        self._passes = passes
        self._listener: socket.socket | None = None
        self._client: _Client | None = None
        self.port = 0
        try:
            self._bus = can.Bus(**bus)
        except (can.CanError, OSError, TypeError, ValueError) as error:
            raise ConnectionFailed(
                f"cannot open {bus['interface']} {bus['channel']}: {error}",
                where="relay",
                remedy="See whether another program has it, and whether it is plugged in.",
            ) from error
        self._heard, self._hears = socket.socketpair()
        self._heard.setblocking(False)
        selector.register(self._heard, selectors.EVENT_READ, self._from_bus)
        self.open()
        threading.Thread(target=self._hear, name="bus", daemon=True).start()

    def open(self) -> None:
        """Let the driver connect, unless it may.

        Raises:
            OSError: the port is taken.
        """
        if self._listener is None:
            self._listener = socket.create_server((self._host, self.port))
            self._listener.setblocking(False)
            self.port = self._listener.getsockname()[1]
            self._selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def close(self) -> None:
        """Hang up, as an adapter that is pulled out. May be called twice."""
        if self._listener is not None:
            self._selector.unregister(self._listener)
            self._listener.close()
            self._listener = None
        self._drop()

    def _accept(self, _: int) -> None:
        assert self._listener is not None
        own, _address = self._listener.accept()
        self._drop()  # the driver has one connection: an older one is dead
        self._client = _Client(own, self._selector, self._from_driver)
        self._tell(b"< hi >", at_once=True)

    def _tell(self, data: bytes, *, at_once: bool = False) -> None:
        if self._client is not None:
            try:
                self._client.tell(data, at_once=at_once)
            except OSError:
                self._drop()

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def _from_driver(self, events: int) -> None:
        client = self._client
        assert client is not None
        try:
            frames = client.exchange(events)
        except OSError:
            self._drop()
            return
        for frame in frames if self._passes(True) else ():
            with contextlib.suppress(can.CanError, OSError):  # that the adapter is gone is heard
                self._bus.send(frame)

    def _from_bus(self, _: int) -> None:
        data = self._heard.recv(CHUNK)
        if not data:  # the adapter is gone
            self._selector.unregister(self._heard)
            self.close()
        elif self._passes(False):
            self._tell(data)

    def _hear(self) -> None:
        """Hear the bus until the process ends, or the adapter is gone."""
        with self._hears:
            while True:
                try:
                    frame = self._bus.recv(LOOK)
                    if frame is not None:
                        self._hears.sendall(line_of(frame))
                except (can.CanError, OSError):
                    return


class _Client:
    """The driver's connection: it opens a channel, whatever its name, and then sends and hears frames."""

    def __init__(
        self, own: socket.socket, selector: selectors.BaseSelector, ready: Callable[[int], None]
    ) -> None:
        self._own = own
        self._selector = selector
        self._ready = ready
        self._input = bytearray()
        self._waiting = bytearray()
        self._hears_from: float | None = None
        own.setblocking(False)
        own.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        selector.register(own, selectors.EVENT_READ, ready)

    def exchange(self, events: int) -> list[can.Message]:
        """Take what it sends; return the frames in it.

        Raises:
            OSError: it is gone.
        """
        if events & selectors.EVENT_WRITE:
            self._send(b"")
        if not events & selectors.EVENT_READ:
            return []
        data = self._own.recv(CHUNK)
        if not data:
            raise ConnectionResetError("it has closed the connection")
        self._input += data
        found, end = [], 0
        for match in _COMMAND.finditer(self._input):
            end = match.end()
            found += self._obey(match[1].split())
        del self._input[:end]
        return found

    def tell(self, lines: bytes, *, at_once: bool) -> None:
        """Send something to it: at once, or frames once it hears them.

        Raises:
            OSError: it is gone.
        """
        hears = self._hears_from is not None and time.monotonic() >= self._hears_from
        if hears or at_once:
            self._send(lines)

    def close(self) -> None:
        """Reset the connection."""
        self._selector.unregister(self._own)
        with contextlib.suppress(OSError):
            self._own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        self._own.close()

    def _obey(self, words: list[bytes]) -> list[can.Message]:
        command = words[0] if words else b""
        if command in (b"open", b"rawmode", b"echo"):
            self._send(b"< echo >" if command == b"echo" else b"< ok >")
            if command == b"rawmode":
                self._hears_from = time.monotonic() + QUIET
            return []
        if self._hears_from is not None:
            self._hears_from = 0.0
            with contextlib.suppress(ValueError, IndexError):
                return [frame_of(words)]
        self._send(b"< error unknown command >")
        return []

    def _send(self, data: bytes) -> None:
        if len(self._waiting) < MOST_WAITING:
            self._waiting += data
        with contextlib.suppress(BlockingIOError):
            while self._waiting:
                del self._waiting[: self._own.send(self._waiting)]
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if self._waiting else 0)
        self._selector.modify(self._own, wanted, self._ready)


def line_of(frame: can.Message) -> bytes:
    """Return how a frame of the bus is told; nothing of a remote frame, which raw mode does not have."""
    if frame.is_error_frame:
        return b"< error %03X %.6f >" % (frame.arbitration_id, frame.timestamp)
    if frame.is_remote_frame:
        return b""
    number = b"%08X" if frame.is_extended_id else b"%03X"
    data = bytes(frame.data).hex().upper().encode()
    return b"< frame %s %.6f %s >" % (number % frame.arbitration_id, frame.timestamp, data)


def frame_of(words: list[bytes]) -> can.Message:
    """Return the frame of ``send ID LENGTH BYTE...``, all hexadecimal; an ID of eight digits is extended.

    Raises:
        ValueError, IndexError: it is none.
    """
    command, number, length, *data = words
    if command != b"send" or int(length, 16) != len(data):
        raise ValueError(f"{command!r} is no frame")
    return can.Message(
        arbitration_id=int(number, 16),
        data=bytes(int(byte, 16) for byte in data),
        is_extended_id=len(number) == 8,
        check=True,
    )
