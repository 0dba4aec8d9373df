"""Locks and threads of a world, in place of those of `_thread`.

`threading` and `queue` stand on them as they are.
"""

from __future__ import annotations

import _thread
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Final

from typing_extensions import override

from crtk_drivers.testing.world.machine.kernel import Kernel, Task, Waiters, here, running

_IMPORTER: Final = object()
"""Who holds a lock before the world has begun, when there is one thread."""
_LONGEST_CIRCLE: Final = 20


class _Taken(ABC):
    """What a `with` statement takes and gives back."""

    __slots__ = ()

    @abstractmethod
    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Take it."""

    @abstractmethod
    def release(self) -> None:
        """Give it back."""

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class Lock(_Taken):
    """As `_thread.lock`.

    An event that looks on, a judge's for instance, passes it: nothing runs meanwhile.
    """

    __slots__ = ("__weakref__", "_owner", "_waiters")

    def __init__(self) -> None:
        self._owner: object = None
        self._waiters: Waiters = {}

    @override
    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Take it."""
        if not blocking and timeout != -1:
            raise ValueError("can't specify a timeout for a non-blocking call")
        if timeout < 0 and timeout != -1:
            raise ValueError("timeout value must be a non-negative number")
        kernel = running.kernel
        if kernel is None:
            if self._owner is not None:
                if blocking:
                    raise RuntimeError("a lock is taken twice at import")
                return False
            self._owner = _IMPORTER
            return True
        task = kernel.current
        if task is None:
            return True
        kernel.preempt()
        if self._owner is None:
            self._owner = task
            return True
        return blocking and self._wait(kernel, task, kernel.deadline(timeout))

    def _wait(self, kernel: Kernel, task: Task, end: int | None) -> bool:
        while self._owner is not None:
            if end is None:
                task.wants = self
                _look_for_circle(kernel, task, self)
            elif kernel.now >= end:
                return False
            kernel.wait((self._waiters,), end)
        task.wants = None
        self._owner = task
        return True

    @override
    def release(self) -> None:
        """Give it back; another thread may have taken it."""
        kernel = running.kernel
        if kernel is not None and kernel.current is None:
            return
        if self._owner is None:
            raise RuntimeError("release unlocked lock")
        self._owner = None
        if self._waiters and kernel is not None:
            kernel.wake(self._waiters)

    def locked(self) -> bool:
        """Return whether somebody has it."""
        return self._owner is not None

    acquire_lock, release_lock, locked_lock = acquire, release, locked

    def _at_fork_reinit(self) -> None:
        self._owner = None


class RLock(_Taken):
    """As `_thread.RLock`."""

    __slots__ = ("__weakref__", "_count", "_lock")

    def __init__(self) -> None:
        self._lock = Lock()
        self._count = 0

    @override
    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Take it, once more if this thread has it."""
        if self._is_owned():
            self._count += 1
            return True
        if not self._lock.acquire(blocking, timeout):
            return False
        if _somebody_runs():
            self._count = 1
        return True

    @override
    def release(self) -> None:
        """Give it back once."""
        if not _somebody_runs():
            return
        if not self._is_owned():
            raise RuntimeError("cannot release un-acquired lock")
        self._count -= 1
        if not self._count:
            self._lock.release()

    def _is_owned(self) -> bool:
        kernel = running.kernel
        me = _IMPORTER if kernel is None else kernel.current
        return me is not None and self._lock._owner is me  # noqa: SLF001 - the two are one thing

    def _release_save(self) -> int:
        count, self._count = self._count, 0
        self._lock.release()
        return count

    def _acquire_restore(self, count: int) -> None:
        self._lock.acquire()
        self._count = count

    def _recursion_count(self) -> int:
        return self._count if self._is_owned() else 0

    def _at_fork_reinit(self) -> None:
        self._lock = Lock()
        self._count = 0


def _somebody_runs() -> bool:
    return running.kernel is None or running.kernel.current is not None


def _look_for_circle(kernel: Kernel, task: Task, wanted: Lock) -> None:
    """Report tasks that wait for each other's locks, this one among them.

    A lock that its owner itself waits for is a condition's: another task will release it.
    """
    names, lock = [repr(task)], wanted
    for _ in range(_LONGEST_CIRCLE):
        owner = lock._owner  # noqa: SLF001 - a lock is asked who has it here only
        if owner is task and len(names) > 1:
            kernel.find("deadlock", " waits for ".join([*names, names[0]]) + "\n" + kernel.stacks())
            kernel.give_way()
        if not isinstance(owner, Task) or owner is task or owner.ended:
            return
        following = owner.wants
        if following is None or following._owner is owner:  # noqa: SLF001
            return
        names.append(repr(owner))
        lock = following


def start_new_thread(
    function: Callable[..., object],
    args: tuple[Any, ...] = (),
    kwargs: Mapping[str, Any] | None = None,
) -> int:
    """As `_thread.start_new_thread`; the number of the task is returned."""
    kernel = here()
    owner = getattr(function, "__self__", None)
    name = getattr(owner, "name", getattr(function, "__name__", "?"))
    task = kernel.start(name, lambda _: function(*args, **(kwargs or {})), kernel.process)
    task.thread = owner
    return task.number


def set_sentinel() -> Lock:
    """As `_thread._set_sentinel`: a lock that is released when this thread has ended (to Python 3.12)."""
    sentinel = Lock()
    if running.kernel is not None and running.kernel.current is not None:
        running.kernel.current.sentinel = sentinel
    return sentinel  # before the world begins: of the main thread, whose end nobody waits for


class ThreadHandle:
    """As `_thread._ThreadHandle` (from Python 3.13 on)."""

    def __init__(self) -> None:
        self.ident = 0
        self._ended = Lock()
        self._is_done = False

    def begin(self) -> None:
        """Count as a thread that runs; called by it."""
        task = here().current
        assert task is not None
        self._ended.acquire()
        task.sentinel = self
        self.ident = _thread.get_ident()

    def release(self) -> None:
        """Count as one that has ended."""
        self._is_done = True
        self._ended.release()

    def is_done(self) -> bool:
        """Return whether the thread has ended."""
        return self._is_done

    def _set_done(self) -> None:
        self._is_done = True

    def join(self, timeout: float | None = None) -> None:
        """Wait for its end."""
        if self._is_done:
            return
        if self._ended.acquire(timeout=-1 if timeout is None else max(0.0, timeout)):
            self._ended.release()


def start_joinable_thread(
    function: Callable[[], object],
    handle: ThreadHandle | None = None,
    daemon: bool = True,
) -> ThreadHandle:
    """As `_thread.start_joinable_thread` (from Python 3.13 on)."""
    found = handle or ThreadHandle()
    kernel = here()
    owner = getattr(function, "__self__", None)
    name = getattr(owner, "name", "?")

    def run(_: Task) -> None:
        found.begin()
        function()

    kernel.start(name, run, kernel.process).thread = owner
    return found


__all__ = [
    "Lock",
    "RLock",
    "ThreadHandle",
    "set_sentinel",
    "start_joinable_thread",
    "start_new_thread",
]
