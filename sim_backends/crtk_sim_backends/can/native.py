"""The hub's own door: a Unix socket that keeps packets apart, one frame in each.

A client that wants more than frames says hello with a packet whose length is no multiple of 16
(`hello`) and gets, in a packet of four bytes, the state of its interface and the file descriptor
of a page that both sides map. The hub writes there what the client has to know before it sends
(`Page`): its state, how many frames may wait for the bus, how many do, how many frames have been
read. From then on the hub sends such a packet of four bytes whenever the state has changed. A
client that says in its hello that it takes batches (`BATCHES`) is sent what there is for it at one
time in one packet, frame after frame.
"""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import select
import socket
import stat
import struct
import tempfile
from pathlib import Path
from typing import Final

from typing_extensions import override

from crtk_sim_backends.can import frames
from crtk_sim_backends.can.client_door import ClientDoor
from crtk_sim_backends.can.node import Bus
from crtk_sim_backends.can.port import State
from crtk_sim_backends.process import AddressInUseError, SimStartError

MAGIC: Final = b"CRTK-CAN"
VERSION: Final = 1
ECHO: Final = 1  # flag of a hello: send me my own frames too
BATCHES: Final = 2  # flag of a hello: a packet to me may have several frames

MAX_PACKET: Final = 4096  # bytes; 256 frames
STATE_PACKET: Final = struct.Struct("<I")
PAGE_SIZE: Final = mmap.PAGESIZE

_HELLO: Final = struct.Struct("<8sBB")
_SEND_BUFFER: Final = 1 << 20
_CLIENTS: Final = 200
_FRAMES_AT_ONCE: Final = 64  # of one client, then the others have their turn


def runtime_folder() -> Path:
    """Folder of the sockets of named hubs, only for this user."""
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"crtk-can-{os.getuid()}"


def socket_path(channel: str) -> str:
    """Path of a hub's socket: itself when `channel` is a path, else that of the hub's name."""
    return channel if "/" in channel else str(runtime_folder() / f"{channel}.sock")


def hello(name: str, flags: int) -> bytes:
    """Build the packet with which a client asks for a page."""
    packet = _HELLO.pack(MAGIC, VERSION, flags) + name.encode()[:200]
    return packet if len(packet) % frames.SIZE else packet + b"\0"


def parse_hello(packet: bytes) -> tuple[str, int] | None:
    """Return name and flags of a hello, or None when it is something else."""
    if len(packet) < _HELLO.size:
        return None
    magic, version, flags = _HELLO.unpack_from(packet)
    if magic != MAGIC or version != VERSION:
        return None
    return packet[_HELLO.size :].rstrip(b"\0").decode(errors="replace"), flags


class Page:
    """The shared page, numbers of 32 bits; only the hub writes.

    `STATE`: :class:`State` of the interface. `LIMIT`: how many frames may wait for the bus, 0 when
    none ever waits. `GONE`: how many frames of this client have left the hub, for the bus or for
    nowhere, modulo 2**32; all others that it sent are waiting. One number, since two that are
    written one after the other count a frame twice in between.
    """

    STATE, LIMIT, GONE = range(3)

    def __init__(self, fd: int, *, write: bool) -> None:
        protection = mmap.PROT_READ | mmap.PROT_WRITE if write else mmap.PROT_READ
        self._map = mmap.mmap(fd, PAGE_SIZE, mmap.MAP_SHARED, protection)
        self.numbers = memoryview(self._map).cast("I")

    def close(self) -> None:
        """Unmap it."""
        self.numbers.release()
        self._map.close()


class _Client:
    """One connection."""

    def __init__(self, door: SocketDoor, hub: Bus, sock: socket.socket) -> None:
        self._door = door
        self._hub = hub
        self._socket = sock
        self._fd = sock.fileno()
        self._more = select.poll()  # asking it takes a quarter of the time of a `recv` in vain
        self._more.register(sock, select.POLLIN)
        self._page: Page | None = None
        self._read = 0  # frames that came
        self._waiting = 0  # how many of them wait for the bus
        self._batches = False
        self._batch = bytearray()  # frames that leave at the end of the hub's round
        self.node = hub.add("native", self)
        hub.loop.watch(self._fd, self._readable)

    def _readable(self, events: int) -> None:
        for _ in range(_FRAMES_AT_ONCE):
            try:
                packet = self._socket.recv(MAX_PACKET)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if not packet:
                self._door.drop(self)
                return
            self._take(packet)
            if not self._more.poll(0):
                return

    def _take(self, packet: bytes) -> None:
        if len(packet) % frames.SIZE == 0:
            for start in range(0, len(packet), frames.SIZE):
                raw = packet[start : start + frames.SIZE]
                self._read += 1
                if frames.fault_of(raw) is None:
                    self._hub.transmit(self.node, raw)
                else:
                    self.node.counters.invalid += 1
            self._tell_gone()
        else:
            asked = parse_hello(packet)
            if asked is None or self._page is not None:
                self.node.counters.invalid += 1
            else:
                self._answer(*asked)

    def _answer(self, name: str, flags: int) -> None:
        """Share a page with the client."""
        hub = self._hub
        fd = os.memfd_create("crtk-can")
        try:
            os.truncate(fd, PAGE_SIZE)
            self._page = Page(fd, write=True)
            self._page.numbers[Page.LIMIT] = hub.queue if hub.bitrate else 0
            self._page.numbers[Page.STATE] = self.node.state
            self._tell_gone()
            if name:
                hub.rename(self.node, name)
            self.node.echo = hub.echo or bool(flags & ECHO)
            self._batches = bool(flags & BATCHES)
            packet = STATE_PACKET.pack(self.node.state)
            with contextlib.suppress(OSError):  # it is gone again: its next packet tells
                socket.send_fds(self._socket, [packet], [fd])
        finally:
            os.close(fd)

    def deliver(self, raw: bytes) -> None:
        """Send a frame, or have it sent with the others of this round."""
        if not self._batches:
            self._hand_over(raw)
            return
        if not self._batch:
            self._hub.after_round(self._flush)
        self._batch += raw
        if len(self._batch) == MAX_PACKET:
            self._flush()

    def _flush(self) -> None:
        if self._batch:
            packet, self._batch = self._batch, bytearray()
            self._hand_over(packet)

    def _hand_over(self, packet: bytes | bytearray) -> None:
        """Send frames, or lose them when the client does not read."""
        try:
            self._socket.send(packet)
        except OSError:  # no room; or it has gone: the socket becomes readable
            self.node.counters.missed += len(packet) // frames.SIZE

    def state_changed(self, state: State) -> None:
        """Tell the client, on the page and with a packet that wakes it."""
        self._flush()
        if self._page is not None:
            self._page.numbers[Page.STATE] = state
            with contextlib.suppress(OSError):
                self._socket.send(STATE_PACKET.pack(state))

    def waiting(self, count: int) -> None:
        """Tell the client how long its queue is."""
        self._waiting = count
        self._tell_gone()

    def _tell_gone(self) -> None:
        if self._page is not None:
            self._page.numbers[Page.GONE] = (self._read - self._waiting) & 0xFFFFFFFF

    def close(self) -> None:
        """Leave the bus and close the connection."""
        self.node.detach()
        self._hub.loop.forget(self._fd)
        self._socket.close()
        if self._page is not None:
            self._page.close()
            self._page = None


class SocketDoor(ClientDoor[_Client]):
    """The listening Unix socket at `path`, which is removed at the end."""

    def __init__(self, hub: Bus, path: str) -> None:
        self.path = path
        super().__init__(hub, _listen(path), _CLIENTS)

    @override
    def _welcome(self, sock: socket.socket) -> _Client:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        return _Client(self, self._hub, sock)

    @override
    def close(self) -> None:
        """Close it and its connections, and remove the file; safe to repeat."""
        is_open = self._listener.fileno() >= 0
        super().close()
        if is_open:
            with contextlib.suppress(OSError):
                os.unlink(self.path)


def _listen(path: str) -> socket.socket:
    try:
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    except OSError as error:
        raise SimStartError(
            f"this system has no Unix sockets that keep packets apart ({error.strerror}); "
            "leave the socket out and use socketcand or slcan"
        ) from error
    try:
        if Path(path).parent == runtime_folder():
            _make_runtime_folder()
        _remove_stale(path)
        sock.bind(path)
        sock.listen(32)
        sock.setblocking(False)
    except OSError as error:
        sock.close()
        raise SimStartError(
            f"cannot listen at {path}: {error.strerror or error}; choose another path (of at most "
            "107 characters) or another name"
        ) from error
    except SimStartError:
        sock.close()
        raise
    return sock


def _make_runtime_folder() -> None:
    folder = runtime_folder()
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise SimStartError(f"{folder} belongs to another user; give the path of a socket instead")


def _remove_stale(path: str) -> None:
    """Remove the socket of a hub that has died; refuse when one lives there."""
    try:
        if not stat.S_ISSOCK(os.stat(path).st_mode):
            raise SimStartError(f"cannot listen at {path}: there is a file; choose another path")
    except FileNotFoundError:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.setblocking(False)
        outcome = probe.connect_ex(path)
    if outcome != errno.ECONNREFUSED:
        raise AddressInUseError(
            f"cannot listen at {path}: another hub is there; stop it, or choose another path"
        )
    os.unlink(path)
