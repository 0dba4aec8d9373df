"""Descriptors of a world's processes, pipes and event counters, in place of those functions of `os`."""

from __future__ import annotations

import errno
import io
import os
import select
from collections.abc import Callable
from typing import Any, Final, Never

from typing_extensions import Buffer, override

from crtk_drivers.testing.world.kernel import NotSimulated, Waiters, here, running

READ: Final = select.POLLIN
WRITE: Final = select.POLLOUT
ERROR: Final = select.POLLERR
HANG_UP: Final = select.POLLHUP

FIRST: Final = 512
"""Descriptors of a world begin here; those below are real files."""
LAST: Final = 1023
"""The last one that `select` takes."""
_PIPE_ROOM: Final = 65_536

_real_poll: Final = select.poll


def fail(code: int) -> Never:
    """Raise the error of a system call."""
    raise OSError(code, os.strerror(code))


class OpenFile:
    """What one or more descriptors lead to, in one or more processes.

    Attributes:
        blocking: whether reading and writing wait.
        waiters: tasks that wait for it, by `select` or in a call.
    """

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
        while not self.events() & (events | ERROR | HANG_UP):
            if end is not None and kernel.now >= end:
                raise TimeoutError("timed out")
            kernel.wait((self.waiters,), end)

    def read(self, most: int) -> bytes:
        """As `os.read`."""
        fail(errno.EBADF)

    def write(self, data: Buffer) -> int:
        """As `os.write`."""
        fail(errno.EBADF)

    def control(self, request: int, argument: Any) -> Any:
        """As `fcntl.ioctl`."""
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


def find(descriptor: int) -> OpenFile:
    """Return the file of a descriptor of this process.

    Raises:
        OSError: it has none (EBADF).
    """
    found = here().process.files.get(descriptor)
    if not isinstance(found, OpenFile):
        fail(errno.EBADF)
    return found


def close(descriptor: int) -> None:
    """Close a descriptor of this process."""
    found = find(descriptor)
    del here().process.files[descriptor]
    found.drop()


def is_ours(descriptor: object) -> bool:
    """Return whether a descriptor is one of a world."""
    return (
        running.kernel is not None and isinstance(descriptor, int) and FIRST <= descriptor <= LAST
    )


def number_of(file: Any) -> int:
    """Return the descriptor of something that has one."""
    return file if isinstance(file, int) else int(file.fileno())


# Real files among those that are waited for: by some, the system tells what programs of a world have done


class _RealFile(OpenFile):
    """A real descriptor that can be waited for, as inotify's."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self.hold()
        self._poll = _real_poll()
        self._poll.register(descriptor, READ)

    @override
    def events(self) -> int:
        return next((events for _, events in self._poll.poll(0)), 0)


_real_files: dict[int, _RealFile] = {}


def find_any(descriptor: int) -> OpenFile:
    """Return the file of a descriptor of this process, or a real one that can be waited for.

    Raises:
        OSError: there is none (EBADF).
    """
    if not 0 <= descriptor < FIRST:
        return find(descriptor)
    if descriptor not in _real_files:
        _real_files[descriptor] = _RealFile(descriptor)
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
    def __init__(self) -> None:
        super().__init__()
        self.data = bytearray()
        self.other: _PipeEnd = self

    @override
    def events(self) -> int:
        found = READ if self.data else 0
        if len(self.other.data) < _PIPE_ROOM:
            found |= WRITE
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

    @override
    def write(self, data: Buffer) -> int:
        here().preempt()
        while self.other.is_open and len(self.other.data) >= _PIPE_ROOM:
            if not self.blocking:
                fail(errno.EAGAIN)
            self.await_events(WRITE, None)
        if not self.other.is_open:
            fail(errno.EPIPE)
        piece = bytes(data)[: _PIPE_ROOM - len(self.other.data)]
        self.other.data += piece
        self.other.changed()
        return len(piece)

    @override
    def released(self) -> None:
        self.other.changed()


def pipe(_flags: int = 0) -> tuple[int, int]:
    """As `os.pipe` and `os.pipe2`."""
    reading, writing = _PipeEnd(), _PipeEnd()
    reading.other, writing.other = writing, reading
    if _flags & os.O_NONBLOCK:
        reading.blocking = writing.blocking = False
    return add(reading), add(writing)


class _Counter(OpenFile):
    def __init__(self, value: int) -> None:
        super().__init__()
        self.value = value

    @override
    def events(self) -> int:
        return WRITE | (READ if self.value else 0)

    def take(self) -> int:
        here().preempt()
        while not self.value:
            if not self.blocking:
                fail(errno.EAGAIN)
            self.await_events(READ, None)
        found, self.value = self.value, 0
        return found

    def put(self, value: int) -> None:
        here().preempt()
        self.value += value
        self.changed()

    @override
    def read(self, most: int) -> bytes:
        return self.take().to_bytes(8, "little")

    @override
    def write(self, data: Buffer) -> int:
        self.put(int.from_bytes(bytes(data), "little"))
        return 8


def eventfd(value: int, flags: int = os.EFD_CLOEXEC) -> int:
    """As `os.eventfd`."""
    if flags & os.EFD_SEMAPHORE:
        raise NotSimulated("EFD_SEMAPHORE")
    counter = _Counter(value)
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
    def close(self) -> None:
        if not self.closed and self._closes:
            close(self._descriptor)
        super().close()


def fdopen(
    descriptor: int,
    mode: str = "r",
    buffering: int = -1,
    encoding: str | None = None,
    errors: str | None = None,
    newline: str | None = None,
    closefd: bool = True,
) -> Any:
    """As `os.fdopen`, for a descriptor of a world."""
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
