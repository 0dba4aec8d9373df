"""One thread's loop: file descriptors that become ready, and functions whose time has come."""

from __future__ import annotations

import heapq
import itertools
import os
import select
import time
from collections.abc import Callable
from typing import Final

READ: Final = select.EPOLLIN
WRITE: Final = select.EPOLLOUT

_PLAIN: Final = (
    READ,
    WRITE,
    READ | WRITE,
)  # else an end or an error, which reading or writing tells
_TICK: Final = 0.001  # s; epoll rounds times up to it, select has microseconds


class Timer:
    """A call that is scheduled; `cancel` prevents it."""

    __slots__ = ("at", "function")

    def __init__(self, at: float, function: Callable[[], object]) -> None:
        self.at = at  # monotonic, s
        self.function: Callable[[], object] | None = function

    def cancel(self) -> None:
        """Do not call it any more; safe to repeat."""
        self.function = None


class Loop:
    """Waits for file descriptors and times. Everything happens in one thread; only `stop` is for others.

    Attributes:
        stopped: whether `stop` was called.
    """

    def __init__(self) -> None:
        self.stopped = False
        self._epoll = select.epoll()
        self._ready: dict[int, Callable[[int], object]] = {}  # by file descriptor
        self._timers: list[tuple[float, int, Timer]] = []
        self._count = itertools.count()
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        os.set_blocking(self._wake_write, False)
        self.watch(self._wake_read, lambda _: os.read(self._wake_read, 4096))

    def run(self) -> None:
        """Do what there is to do until `stop`."""
        while not self.stopped:
            self.step(None)

    def stop(self) -> None:
        """Let `run` return; may be called from any thread and from a signal handler."""
        self.stopped = True
        try:
            os.write(self._wake_write, b"x")
        except BlockingIOError:
            return  # it is awake already

    def watch(self, fd: int, ready: Callable[[int], object], events: int = READ) -> None:
        """Call `ready` with READ, WRITE or both whenever `fd` is; replaces what was there."""
        if fd in self._ready:
            self._epoll.modify(fd, events)
        else:
            self._epoll.register(fd, events)
        self._ready[fd] = ready

    def forget(self, fd: int) -> None:
        """Do not watch `fd` any more; before it is closed. Safe to repeat."""
        if self._ready.pop(fd, None) is not None:
            self._epoll.unregister(fd)

    def call_at(self, at: float, function: Callable[[], object]) -> Timer:
        """Call `function` when the monotonic clock has reached `at` (s)."""
        timer = Timer(at, function)
        heapq.heappush(self._timers, (at, next(self._count), timer))
        return timer

    def step(self, until: float | None) -> None:
        """Wait until `until` (None: as long as it takes) for one event or more, and handle them."""
        while self._timers and self._timers[0][2].function is None:
            heapq.heappop(self._timers)
        if self._timers and (until is None or self._timers[0][0] < until):
            until = self._timers[0][0]
        for fd, events in self._wait(until):
            handler = self._ready.get(fd)  # None: an earlier handler let it go
            if handler is not None:
                handler(events if events in _PLAIN else READ | WRITE)
        if self._timers:
            self._run_timers()

    def _wait(self, until: float | None) -> list[tuple[int, int]]:
        """Return what is ready, at `until` at the latest; its last part is waited for with `select`."""
        while until is not None:
            seconds = until - time.monotonic()
            if seconds < 2.0 * _TICK:
                if seconds > 0.0:
                    select.select([self._epoll], [], [], seconds)
                return self._epoll.poll(0)
            if ready := self._epoll.poll(seconds - _TICK):
                return ready
        return self._epoll.poll()

    def _run_timers(self) -> None:
        now = time.monotonic()
        while self._timers and self._timers[0][0] <= now:
            _, _, timer = heapq.heappop(self._timers)
            function, timer.function = timer.function, None
            if function is not None:
                function()

    def close(self) -> None:
        """Close it, not what it watches; safe to repeat."""
        self._timers.clear()
        if self._wake_read >= 0:
            self._epoll.close()
            os.close(self._wake_read)
            os.close(self._wake_write)
            self._wake_read = self._wake_write = -1


class Ticker:
    """Calls a function at a rate; what it is late by is made up for, up to `BEHIND`. Begins at once.

    Args:
        loop: that calls it.
        period: s.
        tick: is called.
    """

    BEHIND: Final = 0.02  # s

    def __init__(self, loop: Loop, period: float, tick: Callable[[], object]) -> None:
        self._loop = loop
        self._period = period
        self._tick = tick
        self._at = time.monotonic()
        self._timer = loop.call_at(self._at, self._run)

    def _run(self) -> None:
        now = time.monotonic()
        self._at = max(self._at, now - self.BEHIND)
        while self._at <= now:
            self._tick()
            self._at += self._period
        self._timer = self._loop.call_at(self._at, self._run)

    def stop(self) -> None:
        """Do not call it any more; safe to repeat."""
        self._timer.cancel()
