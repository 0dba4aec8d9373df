"""Pseudo-terminals of a world, in place of `os.openpty` and what `termios` does with them.

Each has a real pseudo-terminal beside it, which carries no data: it gives the name, the attributes and the
errors that the system has. So `os.stat`, a symbolic link to it, and whoever counts those who have it open (by
inotify), work as they are. The bytes go through the world, unchanged: a line in raw mode.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import termios
from typing import Any, Final

from typing_extensions import Buffer, override

from crtk_drivers.testing.world import files
from crtk_drivers.testing.world.files import ERROR, HANG_UP, READ, WRITE, OpenFile, fail
from crtk_drivers.testing.world.kernel import NS, here
from crtk_drivers.testing.world.network import network

ROOM: Final = 4095
"""Bytes that a terminal takes that nobody reads."""
_CONTROL_CHARACTERS: Final = 6
"""Index of the control characters in what `termios.tcgetattr` returns."""

_open, _close, _openpty, _ioctl, _get, _set = (
    os.open,
    os.close,
    os.openpty,
    fcntl.ioctl,
    termios.tcgetattr,
    termios.tcsetattr,
)
_ttyname, _realpath = os.ttyname, os.path.realpath


class _Side(OpenFile):
    """One side of a terminal, opened once."""

    def __init__(self, line: _Line, real: int) -> None:
        super().__init__()
        self.line = line
        self.real = real

    @override
    def released(self) -> None:
        _close(self.real)
        files.look_at_real_files()


class _Line:
    """What both sides of a terminal have in common: the bytes under way and those not read."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.to_client = bytearray()
        self.to_master = bytearray()
        self.clients: list[_Client] = []
        self.master: _Master | None = None
        self.locked_by: _Client | None = None
        self._last = 0

    def carry(self, data: bytes, into: bytearray) -> None:
        """Let bytes arrive a moment later."""
        kernel = here()
        self._last = max(self._last + 1, kernel.now + int(network().weather.moment() * NS))
        kernel.note("line", data)

        def arrive() -> None:
            into.extend(data)
            self.changed()

        kernel.at(self._last, arrive)

    def changed(self) -> None:
        """Let both sides look again."""
        for side in (*self.clients, self.master):
            if side is not None:
                side.changed()


class _Master(_Side):
    @override
    def events(self) -> int:
        found = READ if self.line.to_master else 0
        if len(self.line.to_client) < ROOM:
            found |= WRITE
        return found if self.line.clients else found | HANG_UP

    @override
    def read(self, most: int) -> bytes:
        here().preempt()
        line = self.line
        while not line.to_master:
            if not line.clients:
                fail(errno.EIO)
            if not self.blocking:
                fail(errno.EAGAIN)
            self.await_events(READ, None)
        found = bytes(line.to_master[:most])
        del line.to_master[:most]
        line.changed()
        return found

    @override
    def write(self, data: Buffer) -> int:
        here().preempt()
        piece = bytes(data)[: max(0, ROOM - len(self.line.to_client))]
        if not piece:
            fail(errno.EAGAIN)
        self.line.carry(piece, self.line.to_client)
        return len(piece)

    @override
    def control(self, request: int, argument: Any) -> Any:
        return _ioctl(self.real, request, argument)

    @override
    def released(self) -> None:
        _terminals.pop(self.line.name, None)
        self.line.master = None
        super().released()
        self.line.changed()


class _Client(_Side):
    """The side that a program opens by its name."""

    @override
    def events(self) -> int:
        if self.line.master is None:
            return READ | WRITE | ERROR | HANG_UP
        found = READ if self.line.to_client else 0
        return found | WRITE if len(self.line.to_master) < ROOM else found

    @override
    def read(self, most: int) -> bytes:
        here().preempt()
        line = self.line
        while not line.to_client:
            if line.master is None:
                return b""
            least = _get(self.real)[_CONTROL_CHARACTERS][termios.VMIN]
            if not (least[0] if isinstance(least, bytes) else least):
                return b""
            if not self.blocking:
                fail(errno.EAGAIN)
            self.await_events(READ, None)
        found = bytes(line.to_client[:most])
        del line.to_client[:most]
        line.changed()
        return found

    @override
    def write(self, data: Buffer) -> int:
        here().preempt()
        if self.line.master is None:
            fail(errno.EIO)
        piece = bytes(data)[: max(0, ROOM - len(self.line.to_master))]
        if not piece:
            fail(errno.EAGAIN)
        self.line.carry(piece, self.line.to_master)
        return len(piece)

    @override
    def control(self, request: int, argument: Any) -> Any:
        if request == termios.FIONREAD:
            return struct.pack("i", len(self.line.to_client))
        if request == termios.TIOCOUTQ:
            return struct.pack("i", 0)
        return _ioctl(self.real, request, argument)

    @override
    def released(self) -> None:
        self.line.clients.remove(self)
        if self.line.locked_by is self:
            self.line.locked_by = None
        super().released()
        self.line.changed()


_terminals: dict[str, _Line] = {}


def openpty() -> tuple[int, int]:
    """As `os.openpty`."""
    real_master, real_client = _openpty()
    line = _Line(_ttyname(real_client))
    line.master = _Master(line, real_master)
    client = _Client(line, real_client)
    line.clients.append(client)
    _terminals[line.name] = line
    return files.add(line.master), files.add(client)


def open_(path: Any, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
    """As `os.open`; a terminal of the world is known by its name, or by a link to it."""
    if _terminals and isinstance(path, str | os.PathLike) and dir_fd is None:
        line = _terminals.get(_realpath(path))
        if line is not None:
            real = _open(path, flags | os.O_NOCTTY, mode)
            client = _Client(line, real)
            client.blocking = not flags & os.O_NONBLOCK
            line.clients.append(client)
            number = files.add(client)
            files.look_at_real_files()
            here().preempt()
            return number
    return _open(path, flags, mode, dir_fd=dir_fd)


def _side(descriptor: Any) -> _Side:
    found = files.find(files.number_of(descriptor))
    if not isinstance(found, _Side):
        raise termios.error(errno.ENOTTY, os.strerror(errno.ENOTTY))
    return found


def real_of(descriptor: int) -> int:
    """Return the real terminal beside one of a world, for what only asks.

    Raises:
        OSError: the descriptor is no terminal (ENOTTY).
    """
    try:
        return _side(descriptor).real
    except termios.error as error:
        raise OSError(*error.args) from error


def isatty(descriptor: int) -> bool:
    """As `os.isatty`."""
    return isinstance(files.find(descriptor), _Side)


def tcgetattr(descriptor: Any) -> list[Any]:
    """As `termios.tcgetattr`."""
    return _get(_side(descriptor).real)


def tcsetattr(descriptor: Any, when: int, attributes: list[Any]) -> None:
    """As `termios.tcsetattr`."""
    side = _side(descriptor)
    if isinstance(side, _Client) and side.line.master is None:
        raise termios.error(errno.EIO, os.strerror(errno.EIO))
    _set(side.real, termios.TCSANOW, attributes)
    if when == termios.TCSAFLUSH:
        tcflush(descriptor, termios.TCIFLUSH)


def tcflush(descriptor: Any, queue: int) -> None:
    """As `termios.tcflush`."""
    side = _side(descriptor)
    if queue in (termios.TCIFLUSH, termios.TCIOFLUSH):
        (side.line.to_client if isinstance(side, _Client) else side.line.to_master).clear()


def tcdrain(descriptor: Any) -> None:
    """As `termios.tcdrain`."""
    _side(descriptor)
    here().preempt()


def tcsendbreak(descriptor: Any, _duration: int) -> None:
    """As `termios.tcsendbreak`: a pseudo-terminal carries no break."""
    _side(descriptor)


def flock(descriptor: Any, operation: int) -> None:
    """As `fcntl.flock`, of a terminal.

    Raises:
        BlockingIOError: another one has it.
    """
    side = _side(descriptor)
    if not isinstance(side, _Client):
        fail(errno.EINVAL)
    line = side.line
    if operation & fcntl.LOCK_UN:
        line.locked_by = None if line.locked_by is side else line.locked_by
    elif line.locked_by not in (None, side):
        fail(errno.EAGAIN)
    else:
        line.locked_by = side


def fcntl_(descriptor: Any, command: int, argument: int = 0) -> int:
    """As `fcntl.fcntl`, of the flags of a descriptor."""
    file = files.find(files.number_of(descriptor))
    if command == fcntl.F_GETFL:
        return os.O_RDWR | (0 if file.blocking else os.O_NONBLOCK)
    if command == fcntl.F_SETFL:
        file.blocking = not argument & os.O_NONBLOCK
        return 0
    if command in (fcntl.F_GETFD, fcntl.F_SETFD):
        return fcntl.FD_CLOEXEC
    return fail(errno.EINVAL)
