"""The socketcand protocol over TCP, in raw mode, so that its clients can use the hub.

ASCII between angle brackets: ``< hi >``, ``< open can0 >``, ``< rawmode >``, ``< send 123 2 1 2 >``,
``< frame 123 23.424242 0102 >``, ``< error 004 23.424242 >``, ``< echo >``. Source: doc/protocol.md
of github.com/linux-can/socketcand.
"""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable, Mapping
from typing import Final

from typing_extensions import override

from crtk_sim_backends.can import frames
from crtk_sim_backends.can.client_door import ClientDoor
from crtk_sim_backends.can.node import Bus
from crtk_sim_backends.can.port import State
from crtk_sim_backends.kit.loop import READ, WRITE
from crtk_sim_backends.process import listen
from crtk_sim_backends.wire import Connection

PORT: Final = 29536
"""TCP port of socketcand."""

_OK: Final = b"< ok >"
_UNKNOWN: Final = b"< error unknown command >"
_COMMAND: Final = re.compile(rb"<([^<>]*)>")
_LONGEST: Final = 1024  # bytes of an unfinished command; beyond, they are no command
_BACKLOG_LIMIT: Final = 1 << 20
_CLIENTS: Final = 100
_HOLD: Final = 0.25  # s


class CommandError(ValueError):
    """A command that is none, or not in this state."""


def frame_message(raw: bytes, at: float) -> bytes:
    """Message for a received frame, empty for a remote frame, which raw mode does not have."""
    can_id, data = frames.unpack(raw)
    if can_id & frames.ERROR:
        return b"< error %03X %.6f >" % (can_id & frames.EXTENDED_MASK, at)
    if can_id & frames.REMOTE:
        return b""
    if can_id & frames.EXTENDED:
        number = b"%08X" % (can_id & frames.EXTENDED_MASK)
    else:
        number = b"%03X" % (can_id & frames.STANDARD_MASK)
    return b"< frame %s %.6f %s >" % (number, at, data.hex().upper().encode())


def parse_send(words: list[bytes]) -> bytes:
    """Frame of ``send ID LENGTH BYTE...``, all hexadecimal; an identifier of 8 digits is extended.

    Raises:
        CommandError: when it is no classic frame.
    """
    try:
        can_id, length = int(words[1], 16), int(words[2], 16)
        data = bytes(int(word, 16) for word in words[3:])
    except (ValueError, IndexError) as error:
        raise CommandError(f"no frame: {error}") from error
    if len(data) != length or length > frames.MAX_DATA or not 0 <= can_id <= frames.EXTENDED_MASK:
        raise CommandError("no classic frame")
    raw = frames.pack(can_id | (frames.EXTENDED if len(words[1]) == 8 else 0), data)
    fault = frames.fault_of(raw)
    if fault is not None:
        raise CommandError(fault)
    return raw


class _Client:
    """One connection: first it opens the channel, then it chooses raw mode.

    python-can fails to open when frames follow at once upon the answer to ``< rawmode >``. They are
    held back until the client has sent something, which shows that it has read the answer, or for
    a quarter of a second.
    """

    def __init__(self, door: SocketcandDoor, hub: Bus, sock: socket.socket) -> None:
        self._door = door
        self._hub = hub
        self._buffer = bytearray()
        self._opened = False
        self._closed = False
        self._held: list[bytes] | None = None
        self._connection = Connection(sock, _BACKLOG_LIMIT)
        self._fd = sock.fileno()
        self._handlers: Mapping[bytes, Callable[[list[bytes]], None]] = {
            b"open": self._open,
            b"rawmode": self._rawmode,
            b"send": self._send,
            b"echo": self._echo,
        }
        self.node = hub.add("socketcand", self)
        self.node.listening = False
        hub.loop.watch(self._fd, self._ready)
        self._say(b"< hi >")

    def _ready(self, events: int) -> None:
        now = time.monotonic()
        connection = self._connection
        if events & WRITE:
            connection.flush(now)
        if events & READ:
            connection.read(now)
            for piece in connection.take(now):
                self._receive(piece)
        self._settle()

    def _receive(self, data: bytes) -> None:
        self._buffer += data
        end = 0
        for match in _COMMAND.finditer(self._buffer):
            end = match.end()
            self._obey(match[1].split())
        del self._buffer[:end]
        if len(self._buffer) > _LONGEST:
            self.node.counters.invalid += 1
            del self._buffer[:-_LONGEST]

    def _obey(self, words: list[bytes]) -> None:
        if self._held is not None:
            self._let_go()
        words = [bytes(word) for word in words]
        handler = self._handlers.get(words[0] if words else b"")
        try:
            if handler is None:
                raise CommandError("unknown command")
            handler(words)
        except CommandError:
            self.node.counters.invalid += 1
            self._say(_UNKNOWN)

    def _open(self, words: list[bytes]) -> None:
        if self._opened or words[1:] != [self._door.channel.encode()]:
            self._say(b"< error could not open bus >")
            return
        self._opened = True
        self._say(_OK)

    def _rawmode(self, words: list[bytes]) -> None:
        if not self._opened:
            raise CommandError("no channel is open")
        self.node.listening = True
        self._say(_OK)
        self._held = []
        self._hub.call_at(time.monotonic() + _HOLD, self._let_go)

    def _let_go(self) -> None:
        """Send the frames that were held back."""
        held, self._held = self._held, None
        for message in held or ():
            self._send_frame(message)

    def _send_frame(self, message: bytes) -> None:
        if not self._connection.send_fresh(message, time.monotonic()):
            self.node.counters.missed += 1
        self._settle()

    def _send(self, words: list[bytes]) -> None:
        if not self._opened:
            raise CommandError("no channel is open")
        self._hub.transmit(self.node, parse_send(words))

    def _echo(self, words: list[bytes]) -> None:
        self._say(b"< echo >")

    def _say(self, message: bytes) -> None:
        self._connection.send(message, time.monotonic())

    def deliver(self, raw: bytes) -> None:
        """Send a frame, or lose it when the client does not read."""
        message = frame_message(raw, time.time())
        if not message:
            return
        if self._held is None:
            self._send_frame(message)
        else:
            self._held.append(message)

    def state_changed(self, state: State) -> None:
        """Do nothing: the protocol has no words for it."""

    def waiting(self, count: int) -> None:
        """Do nothing: the protocol has no words for it."""

    def _settle(self) -> None:
        """After sending or receiving: watch for what is needed, or let go of a lost connection."""
        if self._closed:
            return
        if self._connection.ended:
            self._door.drop(self)
        else:
            self._hub.loop.watch(
                self._fd, self._ready, READ | WRITE if self._connection.blocked else READ
            )

    def close(self) -> None:
        """Leave the bus and close the connection."""
        self._closed = True
        self.node.detach()
        self._hub.loop.forget(self._fd)
        self._connection.close()


class SocketcandDoor(ClientDoor[_Client]):
    """The listening TCP port; `port` is the one that was found when 0 was asked for."""

    def __init__(self, hub: Bus, host: str, port: int, channel: str) -> None:
        self.channel = channel
        listener = listen(host, port, "socketcand")
        self.port: int = listener.getsockname()[1]
        super().__init__(hub, listener, _CLIENTS)

    @override
    def _welcome(self, sock: socket.socket) -> _Client:
        return _Client(self, self._hub, sock)
