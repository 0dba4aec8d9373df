"""Waiting for descriptors in a world, in place of `select.select`, `poll` and `epoll` (level-triggered)."""

from __future__ import annotations

import errno
import math
import select
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeVar

from typing_extensions import override

from crtk_drivers.testing.world import files
from crtk_drivers.testing.world.files import ERROR, HANG_UP, READ, WRITE, OpenFile, number_of
from crtk_drivers.testing.world.kernel import NotSimulated, Waiters, here, running

_URGENT: Final = select.POLLPRI

Found = TypeVar("Found")


def _queues(watched: Iterable[OpenFile]) -> list[Waiters]:
    """Return what wakes a task that waits for these files, and for what an epoll among them watches."""
    queues, rest = [], list(watched)
    while rest:
        file = rest.pop()
        queues.append(file.waiters)
        if isinstance(file, _EpollFile):
            rest.extend(file.watched())
    return queues


def _until_found(
    look: Callable[[], Found], watched: Callable[[], Iterable[OpenFile]], end: int | None
) -> Found:
    """Wait until `look` returns something, or until a time (ns); then return what it returns."""
    kernel = here()
    kernel.preempt()
    while not (found := look()) and (end is None or kernel.now < end):
        kernel.wait(_queues(watched()), end)
    return found


def _file(descriptor: int) -> OpenFile | None:
    try:
        return files.find_any(descriptor)
    except OSError:
        return None


class Poll:
    """As `select.poll`."""

    def __init__(self) -> None:
        self._wanted: dict[int, int] = {}

    def register(self, file: Any, events: int = READ | WRITE | _URGENT) -> None:
        """Wait for a descriptor from now on."""
        self._wanted[number_of(file)] = events

    def modify(self, file: Any, events: int) -> None:
        """Wait for something else of it."""
        if number_of(file) not in self._wanted:
            files.fail(errno.ENOENT)
        self._wanted[number_of(file)] = events

    def unregister(self, file: Any) -> None:
        """Do not wait for it any more."""
        del self._wanted[number_of(file)]

    def poll(self, timeout: float | None = None) -> list[tuple[int, int]]:
        """Wait for at most `timeout` ms."""
        seconds = None if timeout is None else math.ceil(timeout) / 1000.0
        return _until_found(self._look, self._files, here().deadline(seconds))

    def _look(self) -> list[tuple[int, int]]:
        found = []
        for descriptor, wanted in self._wanted.items():
            if descriptor < 0:
                continue
            file = _file(descriptor)
            if file is None:
                found.append((descriptor, select.POLLNVAL))
            elif events := file.events() & (wanted | ERROR | HANG_UP):
                found.append((descriptor, events))
        return found

    def _files(self) -> list[OpenFile]:
        return [file for each in self._wanted if (file := _file(each)) is not None]


class _EpollFile(OpenFile):
    """What an epoll's descriptor leads to."""

    def __init__(self) -> None:
        super().__init__()
        self.wanted: dict[int, tuple[OpenFile, int]] = {}

    @override
    def events(self) -> int:
        return READ if self.look() else 0

    def look(self) -> list[tuple[int, int]]:
        found = []
        for descriptor, (file, wanted) in list(self.wanted.items()):
            if not file.is_open:
                del self.wanted[descriptor]
            elif events := file.events() & (wanted | ERROR | HANG_UP):
                found.append((descriptor, events))
        return found

    def watched(self) -> list[OpenFile]:
        return [file for file, _ in self.wanted.values()]


class Epoll:
    """As `select.epoll`."""

    def __init__(self, sizehint: int = -1, flags: int = 0) -> None:
        self._descriptor = -1
        self._file = _EpollFile()
        if running.kernel is not None:  # else a module tries whether the system has it
            self._descriptor = files.add(self._file)

    @property
    def closed(self) -> bool:
        """Whether it is closed."""
        return self._descriptor < 0

    def fileno(self) -> int:
        """Return its descriptor."""
        return self._descriptor

    def close(self) -> None:
        """Close it; safe to repeat."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            files.close(descriptor)

    def register(self, file: Any, eventmask: int = READ | WRITE | _URGENT) -> None:
        """Wait for a descriptor from now on."""
        number = number_of(file)
        if eventmask & select.EPOLLET:
            raise NotSimulated("an edge-triggered epoll")
        if number in self._file.wanted and self._file.wanted[number][0].is_open:
            files.fail(errno.EEXIST)
        self._file.wanted[number] = files.find_any(number), eventmask
        self._file.changed()

    def modify(self, file: Any, eventmask: int) -> None:
        """Wait for something else of it."""
        number = number_of(file)
        if number not in self._file.wanted:
            files.fail(errno.ENOENT)
        self._file.wanted[number] = files.find_any(number), eventmask
        self._file.changed()

    def unregister(self, file: Any) -> None:
        """Do not wait for it any more."""
        if self._file.wanted.pop(number_of(file), None) is None:
            files.fail(errno.ENOENT)

    def poll(self, timeout: float | None = None, maxevents: int = -1) -> list[tuple[int, int]]:
        """Wait for at most `timeout` s."""
        if self.closed:
            raise ValueError("I/O operation on closed epoll object")
        whole = None if timeout is None or timeout < 0 else math.ceil(timeout * 1000.0) / 1000.0
        found = _until_found(self._file.look, lambda: (self._file,), here().deadline(whole))
        return found[:maxevents] if maxevents > 0 else found

    def __enter__(self) -> Epoll:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def select_(
    reading: Sequence[Any],
    writing: Sequence[Any],
    other: Sequence[Any],
    timeout: float | None = None,
) -> tuple[list[Any], list[Any], list[Any]]:
    """As `select.select`."""
    sides = [(each, files.find_any(number_of(each)), READ) for each in reading]
    sides += [(each, files.find_any(number_of(each)), WRITE) for each in writing]
    count = len(reading)

    def look() -> tuple[list[Any], list[Any], list[Any]] | tuple[()]:
        ready = [file.events() & (wanted | ERROR | HANG_UP) for _, file, wanted in sides]
        if not any(ready):
            return ()
        named = [
            each if is_ready else None for (each, _, _), is_ready in zip(sides, ready, strict=True)
        ]
        return (
            [each for each in named[:count] if each is not None],
            [each for each in named[count:] if each is not None],
            [],
        )

    found = _until_found(look, lambda: [file for _, file, _ in sides], here().deadline(timeout))
    return found or ([], [], [])
