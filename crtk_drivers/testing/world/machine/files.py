"""Descriptors of a world's processes, pipes and event counters, in place of those functions of `os`."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import stat
import struct
import termios
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final, Never

from typing_extensions import Buffer, override

from crtk_drivers.testing.world.machine.kernel import NotSimulated, Waiters, here, running

READ: Final = select.POLLIN
WRITE: Final = select.POLLOUT
ERROR: Final = select.POLLERR
HANG_UP: Final = select.POLLHUP
PEER_ENDED: Final = select.POLLRDHUP

FIRST: Final = 512
"""Descriptors of a world begin here; those below are real files."""
LAST: Final = 1023
"""The last one that `select` takes."""
_PIPE_ROOM: Final = 65_536
_PIPE_PIECE: Final = 4096
"""Bytes that are written as a whole (PIPE_BUF); a pipe with less room counts as full."""
_MOST_COUNTED: Final = 2**64 - 2

_real_poll: Final = select.poll
_dup, _read, _write, _close = os.dup, os.read, os.write, os.close


def fail(code: int) -> Never:
    """Raise the error of a system call."""
    raise OSError(code, os.strerror(code))


class OpenFile:
    """What one or more descriptors lead to, in one or more processes.

    Attributes:
        blocking: whether reading and writing wait.
        waiters: tasks that wait for it, by `select` or in a call.
        access: O_RDONLY, O_WRONLY or O_RDWR.
        mode: as `os.fstat` has it, S_IFIFO for instance.
    """

    access = os.O_RDWR
    mode = 0

    def __init__(self) -> None:
        self.blocking = True
        self.waiters: Waiters = {}
        self._descriptors = 0

    @property
    def is_open(self) -> bool:
        """Whether a descriptor leads to it."""
        return self._descriptors > 0

    def hold(self) -> None:
        """Count one descriptor more."""
        self._descriptors += 1

    def drop(self) -> None:
        """Count one descriptor less; the last one closes it."""
        self._descriptors -= 1
        if self._descriptors == 0:
            self.released()
            self.changed()

    def released(self) -> None:
        """Do what closing does; waits for nothing."""

    def events(self) -> int:
        """Return what `poll` says of it."""
        return WRITE

    def changed(self) -> None:
        """Let those who wait for it look again."""
        if self.waiters:
            here().wake(self.waiters)

    def await_events(self, events: int, timeout: float | None) -> None:
        """Wait until one of `events` is there.

        Raises:
            TimeoutError: it did not come in time (s; None: no limit).
        """
        kernel = here()
        end = kernel.deadline(timeout)
        with held((self,)):
            while not self.events() & (events | ERROR | HANG_UP):
                if end is not None and kernel.now >= end:
                    raise TimeoutError("timed out")
                kernel.wait((self.waiters,), end)

    def await_change(self, until: int | None = None) -> None:
        """Wait until something of it has changed, or until a time (ns); it stays open meanwhile."""
        with held((self,)):
            here().wait((self.waiters,), until)

    def unread(self) -> int:
        """Return how many bytes can be read."""
        raise NotSimulated(f"FIONREAD of a {type(self).__name__}")

    def read(self, most: int) -> bytes:
        """As `os.read`."""
        fail(errno.EBADF)

    def write(self, data: Buffer) -> int:
        """As `os.write`."""
        fail(errno.EBADF)

    def control(self, request: int, argument: Any) -> Any:
        """As `fcntl.ioctl`."""
        if request == termios.FIONREAD:
            return struct.pack("i", self.unread())
        raise NotSimulated(f"ioctl {request:#x} of a {type(self).__name__}")


# The table of a process


def add(file: OpenFile) -> int:
    """Give a file a descriptor in this process."""
    files = here().process.files
    number = next((n for n in range(FIRST, LAST + 1) if n not in files), None)
    if number is None:
        fail(errno.EMFILE)
    files[number] = file
    file.hold()
    return number


@contextlib.contextmanager
def held(files: Iterable[OpenFile]) -> Iterator[None]:
    """Keep files open while a system call waits for them, though another thread may close the descriptors.

    They are in the table of the process below 0, where nobody finds them, and end with it.
    """
    table = here().process.files
    numbers = []
    for file in files:
        number = min(0, *table) - 1 if table else -1
        table[number] = file
        file.hold()
        numbers.append(number)
    try:
        yield
    finally:
        for number in numbers:
            table.pop(number).drop()


def find(descriptor: int) -> OpenFile:
    """Return the file of a descriptor of this process.

    Raises:
        OSError: it has none (EBADF).
    """
    found = here().process.files.get(descriptor) if descriptor >= 0 else None
    if not isinstance(found, OpenFile):
        fail(errno.EBADF)
    return found


def close(descriptor: int) -> None:
    """Close a descriptor of this process."""
    found = find(descriptor)
    del here().process.files[descriptor]
    found.drop()


def dup(descriptor: int) -> int:
    """Return another descriptor of the same file."""
    return add(find(descriptor))


def dup2(descriptor: int, other: int, _inheritable: bool = True) -> int:
    """As `os.dup2`, of a descriptor of a world."""
    found = find(descriptor)
    if other != descriptor:
        found.hold()
        before = here().process.files.get(other)
        here().process.files[other] = found
        if before is not None:
            before.drop()
    return other


def is_ours(descriptor: object) -> bool:
    """Return whether a descriptor is one of a world."""
    if running.kernel is None or not isinstance(descriptor, int):
        return False
    return FIRST <= descriptor <= LAST or (
        descriptor >= 0 and descriptor in running.kernel.process.files
    )


def number_of(file: Any) -> int:
    """Return the descriptor of something that has one.

    Raises:
        TypeError: it has none.
        ValueError: it is closed.
    """
    if not isinstance(file, int):
        if not hasattr(file, "fileno"):
            raise TypeError("argument must be an int, or have a fileno() method.")
        file = file.fileno()
    if file < 0:
        raise ValueError(f"file descriptor cannot be a negative integer ({file})")
    return int(file)


def status(descriptor: int) -> os.stat_result:
    """As `os.fstat`, of what is no terminal."""
    return os.stat_result((find(descriptor).mode | 0o600, 0, 0, 1, 0, 0, 0, 0, 0, 0))


# Real files among those that are waited for: by some, the system tells what programs of a world have done


class RealFile(OpenFile):
    """A real descriptor that can be waited for, as inotify's."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self.hold()
        self._poll = _real_poll()
        self._poll.register(descriptor, READ)

    @override
    def events(self) -> int:
        return next((events for _, events in self._poll.poll(0)), 0)


class RealOutput(OpenFile):
    """A real file that a child has in place of its input or output, as a log or the null device."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._real = _dup(descriptor)

    @override
    def events(self) -> int:
        return READ | WRITE

    @override
    def read(self, most: int) -> bytes:
        return _read(self._real, most)

    @override
    def write(self, data: Buffer) -> int:
        return _write(self._real, data)

    @override
    def released(self) -> None:
        _close(self._real)


_real_files: dict[int, RealFile] = {}


def find_any(descriptor: int) -> OpenFile:
    """Return the file of a descriptor of this process, or a real one that can be waited for.

    Raises:
        OSError: there is none (EBADF).
    """
    if is_ours(descriptor):
        return find(descriptor)
    if descriptor not in _real_files:
        _real_files[descriptor] = RealFile(descriptor)
    return _real_files[descriptor]


def look_at_real_files() -> None:
    """Let those who wait for a real file look again: something was done of which the system tells by it."""
    for file in _real_files.values():
        file.changed()


def forget_real(descriptor: int) -> None:
    """Close a real file for those who wait for it: its number may soon be another file's."""
    if (file := _real_files.pop(descriptor, None)) is not None:
        file.drop()


# Pipes and counters


class _PipeEnd(OpenFile):
    mode = stat.S_IFIFO

    def __init__(self, data: bytearray) -> None:
        super().__init__()
        self.data = data
        self.other: _PipeEnd = self

    @override
    def unread(self) -> int:
        return len(self.data)

    @override
    def released(self) -> None:
        self.other.changed()


class _ReadingEnd(_PipeEnd):
    access = os.O_RDONLY

    @override
    def events(self) -> int:
        found = READ if self.data else 0
        return found if self.other.is_open else found | HANG_UP

    @override
    def read(self, most: int) -> bytes:
        here().preempt()
        while not self.data:
            if not self.other.is_open:
                return b""
            if not self.blocking:
                fail(errno.EAGAIN)
            self.await_events(READ, None)
        found = bytes(self.data[:most])
        del self.data[:most]
        self.other.changed()
        return found


class _WritingEnd(_PipeEnd):
    access = os.O_WRONLY

    @override
    def events(self) -> int:
        found = WRITE if len(self.data) + _PIPE_PIECE <= _PIPE_ROOM else 0
        return found if self.other.is_open else found | ERROR

    @override
    def write(self, data: Buffer) -> int:
        here().preempt()
        rest, count = memoryview(data).cast("B"), 0
        while rest:
            if not self.other.is_open:
                return count or fail(errno.EPIPE)
            room = _PIPE_ROOM - len(self.data)
            if room < min(len(rest), _PIPE_PIECE):
                if not self.blocking:
                    return count or fail(errno.EAGAIN)
                self.await_change()
                continue
            piece, rest = rest[:room], rest[room:]
            self.data += piece
            count += len(piece)
            self.other.changed()
        return count


def pipe(_flags: int = 0) -> tuple[int, int]:
    """As `os.pipe` and `os.pipe2`."""
    data = bytearray()
    reading, writing = _ReadingEnd(data), _WritingEnd(data)
    reading.other, writing.other = writing, reading
    if _flags & os.O_NONBLOCK:
        reading.blocking = writing.blocking = False
    return add(reading), add(writing)


class _Counter(OpenFile):
    def __init__(self, value: int, *, counts_down: bool) -> None:
        super().__init__()
        self.value = value
        self._counts_down = counts_down

    @override
    def events(self) -> int:
        return (WRITE if self.value < _MOST_COUNTED else 0) | (READ if self.value else 0)

    def take(self) -> int:
        here().preempt()
        while not self.value:
            if not self.blocking:
                fail(errno.EAGAIN)
            self.await_events(READ, None)
        found = 1 if self._counts_down else self.value
        self.value -= found
        self.changed()
        return found

    def put(self, value: int) -> None:
        here().preempt()
        if value > _MOST_COUNTED:
            fail(errno.EINVAL)
        while self.value + value > _MOST_COUNTED:
            if not self.blocking:
                fail(errno.EAGAIN)
            self.await_change()
        self.value += value
        self.changed()

    @override
    def read(self, most: int) -> bytes:
        return fail(errno.EINVAL) if most < 8 else self.take().to_bytes(8, "little")

    @override
    def write(self, data: Buffer) -> int:
        whole = bytes(data)
        if len(whole) < 8:
            fail(errno.EINVAL)
        self.put(int.from_bytes(whole[:8], "little"))
        return 8


def eventfd(value: int, flags: int = os.EFD_CLOEXEC) -> int:
    """As `os.eventfd`."""
    counter = _Counter(value, counts_down=bool(flags & os.EFD_SEMAPHORE))
    counter.blocking = not flags & os.EFD_NONBLOCK
    return add(counter)


def _counter(descriptor: int) -> _Counter:
    found = find(descriptor)
    return found if isinstance(found, _Counter) else fail(errno.EINVAL)


def eventfd_read(descriptor: int) -> int:
    """As `os.eventfd_read`."""
    return _counter(descriptor).take()


def eventfd_write(descriptor: int, value: int) -> None:
    """As `os.eventfd_write`."""
    _counter(descriptor).put(value)


# Python's files on a descriptor


class _Raw(io.RawIOBase):
    def __init__(self, descriptor: int, mode: str, *, closes: bool) -> None:
        self._descriptor = descriptor
        self._mode = mode
        self._closes = closes

    @override
    def fileno(self) -> int:
        return self._descriptor

    @override
    def readable(self) -> bool:
        return "r" in self._mode or "+" in self._mode

    @override
    def writable(self) -> bool:
        return "r" not in self._mode or "+" in self._mode

    @override
    def readinto(self, buffer: Any) -> int | None:
        try:
            data = find(self._descriptor).read(len(buffer))
        except BlockingIOError:
            return None
        buffer[: len(data)] = data
        return len(data)

    @override
    def write(self, data: Any) -> int | None:
        try:
            return find(self._descriptor).write(data)
        except BlockingIOError:
            return None

    @override
    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    @override
    def close(self) -> None:
        if not self.closed:
            super().close()
            if self._closes:
                close(self._descriptor)


def fdopen(
    descriptor: int,
    mode: str = "r",
    buffering: int = -1,
    encoding: str | None = None,
    errors: str | None = None,
    newline: str | None = None,
    closefd: bool = True,
    opener: object = None,
) -> Any:
    """As `os.fdopen`, for a descriptor of a world."""
    find(descriptor)
    raw = _Raw(descriptor, mode, closes=closefd)
    if buffering == 0:
        return raw
    make: Callable[[Any], Any] = io.BufferedReader
    if "+" in mode:
        raise NotSimulated("fdopen for reading and writing")
    if "r" not in mode:
        make = io.BufferedWriter
    buffered = make(raw)
    if "b" in mode:
        return buffered
    return io.TextIOWrapper(buffered, encoding, errors, newline, line_buffering=buffering == 1)
