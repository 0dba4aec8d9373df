"""Waiting for descriptors in a world, in place of `select.select`, `poll` and `epoll` (level-triggered)."""

from __future__ import annotations

import contextlib
import errno
import math
import select
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeVar

from typing_extensions import override

from crtk_drivers.testing.world.machine import files
from crtk_drivers.testing.world.machine.files import (
    ERROR,
    HANG_UP,
    READ,
    WRITE,
    OpenFile,
    number_of,
)
from crtk_drivers.testing.world.machine.kernel import NotSimulated, Waiters, here, running

_URGENT: Final = select.POLLPRI
_REFUSED: Final = {
    "an edge-triggered epoll": select.EPOLLET,
    "EPOLLEXCLUSIVE": select.EPOLLEXCLUSIVE,
}

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


def _kept(watched: Iterable[OpenFile]) -> contextlib.AbstractContextManager[None]:
    """Keep the files of the world open meanwhile; real ones are not ours to keep."""
    return files.held([file for file in watched if not isinstance(file, files.RealFile)])


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
        wanted = [(each, _file(each), events) for each, events in self._wanted.items()]
        files_ = [file for _, file, _ in wanted if file is not None]

        def look() -> list[tuple[int, int]]:
            found = []
            for descriptor, file, asked in wanted:
                if file is None:
                    found.append((descriptor, select.POLLNVAL))
                elif events := file.events() & (asked | ERROR | HANG_UP):
                    found.append((descriptor, events))
            return found

        with _kept(files_):
            return _until_found(look, lambda: files_, here().deadline(seconds))


class _EpollFile(OpenFile):
    """What an epoll's descriptor leads to."""

    def __init__(self) -> None:
        super().__init__()
        self.wanted: dict[tuple[int, OpenFile], int] = {}
        """By descriptor and file, as Linux has it: the number may be another file's by now."""

    @override
    def events(self) -> int:
        return READ if self.look() else 0

    def look(self, most: int = -1) -> list[tuple[int, int]]:
        found = []
        for key, wanted in list(self.wanted.items()):
            descriptor, file = key
            if not file.is_open:
                del self.wanted[key]
            elif events := file.events() & _asked(wanted):
                found.append((descriptor, events))
                if len(found) == most:
                    break
        return found

    def take(self, most: int) -> list[tuple[int, int]]:
        """Look, and switch off what was to be told once."""
        found = self.look(most)
        told = {descriptor for descriptor, _ in found}
        for key, wanted in self.wanted.items():
            if wanted & select.EPOLLONESHOT and key[0] in told:
                self.wanted[key] = select.EPOLLONESHOT
        return found

    def watched(self) -> list[OpenFile]:
        return [file for _, file in self.wanted]


def _asked(wanted: int) -> int:
    """Return the events that an epoll's entry asks for; none once it was told, if it is to be told once."""
    return 0 if wanted == select.EPOLLONESHOT else wanted | ERROR | HANG_UP


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
        if self.closed:
            raise ValueError("I/O operation on closed epoll object")
        return self._descriptor

    def close(self) -> None:
        """Close it; safe to repeat."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            files.close(descriptor)

    def _key(self, file: Any) -> tuple[int, OpenFile]:
        self.fileno()  # which says so if it is closed
        number = number_of(file)
        return number, files.find_any(number)

    def register(self, file: Any, eventmask: int = READ | WRITE | _URGENT) -> None:
        """Wait for a descriptor from now on."""
        key = self._key(file)
        for name, flag in _REFUSED.items():
            if eventmask & flag:
                raise NotSimulated(name)
        if key in self._file.wanted:
            files.fail(errno.EEXIST)
        self._file.wanted[key] = eventmask
        self._file.changed()

    def modify(self, file: Any, eventmask: int) -> None:
        """Wait for something else of it."""
        key = self._key(file)
        if key not in self._file.wanted:
            files.fail(errno.ENOENT)
        self._file.wanted[key] = eventmask
        self._file.changed()

    def unregister(self, file: Any) -> None:
        """Do not wait for it any more."""
        if self._file.wanted.pop(self._key(file), None) is None:
            files.fail(errno.ENOENT)

    def poll(self, timeout: float | None = None, maxevents: int = -1) -> list[tuple[int, int]]:
        """Wait for at most `timeout` s."""
        self.fileno()  # which says so if it is closed
        if maxevents < -1 or maxevents == 0:
            raise ValueError(f"maxevents must be greater than 0, got {maxevents}")
        whole = None if timeout is None or timeout < 0 else math.ceil(timeout * 1000.0) / 1000.0
        epoll = self._file
        return _until_found(lambda: epoll.take(maxevents), lambda: (epoll,), here().deadline(whole))

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
    if timeout is not None and timeout < 0:
        raise ValueError("timeout must be non-negative")
    for each in other:
        files.find_any(number_of(each))  # nothing urgent ever comes
    sides = [(each, files.find_any(number_of(each)), READ | HANG_UP | ERROR) for each in reading]
    sides += [(each, files.find_any(number_of(each)), WRITE | ERROR) for each in writing]
    count = len(reading)
    watched = [file for _, file, _ in sides]

    def look() -> tuple[list[Any], list[Any], list[Any]] | tuple[()]:
        ready = [bool(file.events() & wanted) for _, file, wanted in sides]
        if not any(ready):
            return ()
        chosen = [(place, side[0]) for place, side in enumerate(sides) if ready[place]]
        return (
            [each for place, each in chosen if place < count],
            [each for place, each in chosen if place >= count],
            [],
        )

    with _kept(watched):
        return _until_found(look, lambda: watched, here().deadline(timeout)) or ([], [], [])
