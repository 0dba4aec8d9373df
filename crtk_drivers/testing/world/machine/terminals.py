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

from crtk_drivers.testing.world.machine import files
from crtk_drivers.testing.world.machine.endpoints import network
from crtk_drivers.testing.world.machine.files import ERROR, HANG_UP, READ, WRITE, OpenFile, fail
from crtk_drivers.testing.world.machine.kernel import NS, NotSimulated, here

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
_ttyname, _realpath, _fstat = os.ttyname, os.path.realpath, os.fstat
_LOCAL_MODES: Final = 3
_OUTPUT_MODES: Final = 1
"""Indices of these in it."""


class _Side(OpenFile):
    """One side of a terminal, opened once."""

    def __init__(self, line: _Line, real: int) -> None:
        super().__init__()
        self.line = line
        self.real = real

    @property
    def is_hung_up(self) -> bool:
        """Whether the other side has ended for good."""
        return False

    def check(self) -> None:
        """Raise EIO, as `termios` does, if the other side has ended for good."""
        if self.is_hung_up:
            raise termios.error(errno.EIO, os.strerror(errno.EIO))

    @property
    def incoming(self) -> _Queue:
        """What this side reads."""
        raise NotImplementedError

    @property
    def outgoing(self) -> _Queue:
        """What this side writes."""
        raise NotImplementedError

    @override
    def unread(self) -> int:
        return len(self.incoming.data)

    def take(self, most: int) -> bytes:
        """Return up to so many bytes that have arrived."""
        queue = self.incoming
        found = bytes(queue.data[:most])
        del queue.data[:most]
        self.line.changed()
        return found

    @override
    def write(self, data: Buffer) -> int:
        here().preempt()
        rest, count = memoryview(data).cast("B"), 0
        while rest:
            if self.is_hung_up:
                return count or fail(errno.EIO)
            room = ROOM - self.outgoing.size
            if room <= 0:
                if not self.blocking:
                    return count or fail(errno.EAGAIN)
                self.await_change()
                continue
            piece, rest = bytes(rest[:room]), rest[room:]
            self.check_modes(piece)
            self.line.carry(piece, self.outgoing)
            count += len(piece)
        return count

    def check_modes(self, data: bytes) -> None:
        """Refuse what would not go through as it is."""

    @override
    def control(self, request: int, argument: Any) -> Any:
        if self.is_hung_up:
            fail(errno.EIO)
        if request == termios.FIONREAD:
            return struct.pack("i", self.unread())
        if request == termios.TIOCOUTQ:
            return struct.pack("i", 0)
        return _ioctl(self.real, request, argument)

    @override
    def released(self) -> None:
        _close(self.real)
        files.look_at_real_files()


class _Queue:
    """Bytes of one direction."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.under_way = 0

    @property
    def size(self) -> int:
        """Of those that have arrived and those that have not."""
        return len(self.data) + self.under_way


class _Line:
    """What both sides of a terminal have in common: the bytes under way and those not read."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.to_client = _Queue()
        self.to_master = _Queue()
        self.clients: list[_Client] = []
        self.master: _Master | None = None
        self.locks: dict[_Client, int] = {}
        self._last = 0

    def carry(self, data: bytes, into: _Queue) -> None:
        """Let bytes arrive a moment later."""
        kernel = here()
        self._last = max(self._last + 1, kernel.now + int(network().weather.moment() * NS))
        kernel.note("line", data)
        into.under_way += len(data)

        def arrive() -> None:
            into.under_way -= len(data)
            into.data += data
            self.changed()

        kernel.at(self._last, arrive)

    def changed(self) -> None:
        """Let both sides look again."""
        for side in (*self.clients, self.master):
            if side is not None:
                side.changed()


class _Master(_Side):
    @property
    @override
    def incoming(self) -> _Queue:
        return self.line.to_master

    @property
    @override
    def outgoing(self) -> _Queue:
        return self.line.to_client

    @override
    def events(self) -> int:
        found = READ if self.incoming.data else 0
        if self.outgoing.size < ROOM:
            found |= WRITE
        return found if self.line.clients else found | HANG_UP

    @override
    def check_modes(self, data: bytes) -> None:
        if _get(self.real)[_LOCAL_MODES] & (termios.ICANON | termios.ECHO):
            raise NotSimulated("a terminal that edits lines or echoes: use tty.setraw")

    @override
    def read(self, most: int) -> bytes:
        here().preempt()
        queue = self.incoming
        while not queue.data:
            if not self.line.clients and not queue.under_way:
                fail(errno.EIO)
            if not self.blocking:
                fail(errno.EAGAIN)
            self.await_change()
        return self.take(most)

    @override
    def released(self) -> None:
        _terminals.pop(self.line.name, None)
        self.line.master = None
        self.line.to_client.data.clear()
        super().released()
        self.line.changed()


class _Client(_Side):
    """The side that a program opens by its name."""

    @property
    @override
    def is_hung_up(self) -> bool:
        return self.line.master is None

    @property
    @override
    def incoming(self) -> _Queue:
        return self.line.to_client

    @property
    @override
    def outgoing(self) -> _Queue:
        return self.line.to_master

    @override
    def events(self) -> int:
        if self.is_hung_up:
            return READ | WRITE | ERROR | HANG_UP
        found = READ if self.incoming.data else 0
        return found | WRITE if self.outgoing.size < ROOM else found

    @override
    def check_modes(self, data: bytes) -> None:
        if b"\n" in data and _get(self.real)[_OUTPUT_MODES] & termios.OPOST:
            raise NotSimulated("a terminal that changes the ends of lines: use tty.setraw")

    @override
    def read(self, most: int) -> bytes:
        here().preempt()
        queue, end = self.incoming, -1
        while not self.is_hung_up:
            modes = _get(self.real)
            if modes[_LOCAL_MODES] & termios.ICANON:
                raise NotSimulated("a terminal that edits lines: use tty.setraw")
            least, tenths = (
                each[0] if isinstance(each, bytes) else each
                for each in (modes[_CONTROL_CHARACTERS][place] for place in _WAITING)
            )
            if least > 1:
                raise NotSimulated(f"a terminal with VMIN {least}")
            if queue.data:
                break
            if not least:
                end = here().now + tenths * NS // 10 if end < 0 else end
                if here().now >= end:
                    return b""
            if not self.blocking:
                fail(errno.EAGAIN)
            self.await_change(None if least else end)
        return self.take(most)

    @override
    def released(self) -> None:
        self.line.clients.remove(self)
        self.line.locks.pop(self, None)
        super().released()
        self.line.changed()


_WAITING: Final = (termios.VMIN, termios.VTIME)


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
    line = _line_at(path) if dir_fd is None else None
    if line is None:
        return _open(path, flags, mode, dir_fd=dir_fd)
    real = _open(path, flags | os.O_NOCTTY, mode)
    client = _Client(line, real)
    client.blocking = not flags & os.O_NONBLOCK
    client.access = flags & os.O_ACCMODE
    line.clients.append(client)
    number = files.add(client)
    files.look_at_real_files()
    here().preempt()
    return number


def is_terminal(path: Any) -> bool:
    """Return whether a path leads to a terminal of the world."""
    return _line_at(path) is not None


def _line_at(path: Any) -> _Line | None:
    if not _terminals or not isinstance(path, str | os.PathLike):
        return None
    return _terminals.get(_realpath(path))


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


def status(descriptor: int) -> os.stat_result:
    """As `os.fstat`, for a descriptor of a world."""
    side = files.find(descriptor)
    return _fstat(side.real) if isinstance(side, _Side) else files.status(descriptor)


def isatty(descriptor: int) -> bool:
    """As `os.isatty`."""
    found = here().process.files.get(descriptor)
    return isinstance(found, _Side) and not found.is_hung_up


def tcgetattr(descriptor: Any) -> list[Any]:
    """As `termios.tcgetattr`."""
    side = _side(descriptor)
    side.check()
    return _get(side.real)


def tcsetattr(descriptor: Any, when: int, attributes: list[Any]) -> None:
    """As `termios.tcsetattr`."""
    side = _side(descriptor)
    side.check()
    _set(side.real, termios.TCSANOW, attributes)
    if when == termios.TCSAFLUSH:
        tcflush(descriptor, termios.TCIFLUSH)
    side.changed()


def tcflush(descriptor: Any, queue: int) -> None:
    """As `termios.tcflush`; what is on its way is neither here nor there."""
    side = _side(descriptor)
    side.check()
    if queue in (termios.TCIFLUSH, termios.TCIOFLUSH):
        side.incoming.data.clear()
        side.line.changed()


def tcdrain(descriptor: Any) -> None:
    """As `termios.tcdrain`."""
    _side(descriptor).check()
    here().preempt()


def tcsendbreak(descriptor: Any, _duration: int) -> None:
    """As `termios.tcsendbreak`: a pseudo-terminal carries no break."""
    _side(descriptor).check()


def flock(descriptor: Any, operation: int) -> None:
    """As `fcntl.flock`, of a terminal's client.

    Raises:
        BlockingIOError: another one has it.
    """
    side = files.find(files.number_of(descriptor))
    if not isinstance(side, _Client):
        raise NotSimulated("flock of anything but a file and a terminal's client")
    locks = side.line.locks
    if operation & fcntl.LOCK_UN:
        locks.pop(side, None)
        return
    wanted = operation & (fcntl.LOCK_SH | fcntl.LOCK_EX)
    others = [kind for each, kind in locks.items() if each is not side]
    if others and (wanted == fcntl.LOCK_EX or fcntl.LOCK_EX in others):
        if not operation & fcntl.LOCK_NB:
            raise NotSimulated("flock that waits")
        locks.pop(side, None)  # as Linux: a lock that cannot be exchanged is lost
        fail(errno.EAGAIN)
    locks[side] = wanted


def fcntl_(descriptor: Any, command: int, argument: int = 0) -> int:
    """As `fcntl.fcntl`, of the flags of a descriptor."""
    file = files.find(files.number_of(descriptor))
    if command == fcntl.F_GETFL:
        return file.access | (0 if file.blocking else os.O_NONBLOCK)
    if command == fcntl.F_SETFL:
        file.blocking = not argument & os.O_NONBLOCK
        return 0
    if command in (fcntl.F_GETFD, fcntl.F_SETFD):
        return fcntl.FD_CLOEXEC if command == fcntl.F_GETFD else 0
    raise NotSimulated(f"fcntl {command}")
