"""Put a world in place of the operating system, in the modules of the standard library.

This comes before anything that keeps a function of these modules is imported. No other source is changed.
"""

from __future__ import annotations

import _socket
import _thread
import atexit
import builtins
import contextlib
import datetime
import errno
import faulthandler
import fcntl
import functools
import importlib
import io
import os
import random
import select
import sys
import termios
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any, Final, NoReturn

from crtk_drivers.testing.world.machine import (
    files,
    polling,
    task_locks,
    terminals,
    virtual_clocks,
    world_sockets,
)
from crtk_drivers.testing.world.machine.kernel import NotSimulated, running

_TOO_LATE: Final = (
    "asyncio",
    "logging",
    "multiprocessing",
    "queue",
    "selectors",
    "socket",
    "subprocess",
    "threading",
)
"""Modules that keep what is replaced: they are imported later."""

_THREADS: Final[dict[str, Any]] = {
    "allocate_lock": task_locks.Lock,
    "lock": task_locks.Lock,
    "LockType": task_locks.Lock,
    "RLock": task_locks.RLock,
    "start_new_thread": task_locks.start_new_thread,
    "start_new": task_locks.start_new_thread,
    "_set_sentinel": task_locks.set_sentinel,
    "start_joinable_thread": task_locks.start_joinable_thread,
    "_ThreadHandle": task_locks.ThreadHandle,
}
_CLOCKS: Final[dict[str, Any]] = {
    "monotonic": virtual_clocks.monotonic,
    "monotonic_ns": virtual_clocks.monotonic_ns,
    "perf_counter": virtual_clocks.monotonic,
    "perf_counter_ns": virtual_clocks.monotonic_ns,
    "process_time": virtual_clocks.monotonic,
    "thread_time": virtual_clocks.monotonic,
    "time": virtual_clocks.wall,
    "time_ns": virtual_clocks.time_ns,
    "sleep": virtual_clocks.sleep,
    "localtime": virtual_clocks.localtime,
    "gmtime": virtual_clocks.gmtime,
    "asctime": virtual_clocks.asctime,
    "ctime": virtual_clocks.ctime,
    "strftime": virtual_clocks.strftime,
}
_DATES: Final[dict[str, Any]] = {"date": virtual_clocks.Date, "datetime": virtual_clocks.Datetime}
_POLLING: Final[dict[str, Any]] = {
    "select": polling.select_,
    "poll": polling.Poll,
    "epoll": polling.Epoll,
}
_SOCKETS: Final[dict[str, Any]] = {
    "socket": world_sockets.Socket,
    "SocketType": world_sockets.Socket,
    "socketpair": world_sockets.socketpair,
    "close": files.close,
    "dup": files.dup,
    "getaddrinfo": world_sockets.getaddrinfo,
    "gethostbyname": world_sockets.gethostbyname,
    "gethostbyaddr": world_sockets.gethostbyaddr,
    "getnameinfo": world_sockets.getnameinfo,
    "getdefaulttimeout": world_sockets.getdefaulttimeout,
    "setdefaulttimeout": world_sockets.setdefaulttimeout,
}
_REFUSED: Final = {
    "os": (
        "fork forkpty posix_spawn posix_spawnp execv execve wait wait3 wait4 waitpid waitid pidfd_open "
        "splice sendfile timerfd_create killpg system"
    ),
    "signal": (
        "alarm setitimer pthread_kill pthread_sigmask sigwait sigwaitinfo sigtimedwait pause "
        "siginterrupt pidfd_send_signal"
    ),
    "_socket": "gethostbyname_ex",
}
_REFUSED_OF_DESCRIPTORS: Final = (
    "readv writev pread pwrite preadv pwritev ftruncate fsync fchmod fchown"
)
"""Functions of `os` that a descriptor of a world does not have."""


def install() -> None:
    """Patch the standard library of this process, for good.

    Raises:
        RuntimeError: something that keeps the real functions is imported already.
    """
    if early := [name for name in _TOO_LATE if name in sys.modules]:
        raise RuntimeError(f"a world is installed before these are imported: {', '.join(early)}")
    running.patched = True
    for module, new in (
        (_thread, _THREADS),
        (time, _CLOCKS),
        (datetime, _DATES),
        (select, _POLLING),
        (_socket, _SOCKETS),
    ):
        _put(module, new)
    _put(functools, {"RLock": task_locks.RLock})
    _put(random, {"_urandom": _urandom})
    _put(faulthandler, {"enable": _enable_where_it_can(faulthandler.enable)})
    # `queue` has the same in Python.
    sys.modules["_queue"] = None  # type: ignore[assignment]
    _put_os()
    for name, refused in _REFUSED.items():
        found = importlib.import_module(name)
        _put(found, {each: _refusal(f"{name}.{each}") for each in refused.split()})
    _put_terminals()
    _put_processes()
    _let_seeds_be_of_the_world()
    virtual_clocks.let_dates_be_copied()
    os.environ["TZ"] = "UTC"  # whatever the zone of this machine is
    time.tzset()


def _put(module: ModuleType, new: dict[str, Any]) -> None:
    """Replace what a module has; what this version of Python does not have is left out."""
    for name, value in new.items():
        if hasattr(module, name):
            setattr(module, name, value)


def _refusal(name: str) -> Callable[..., NoReturn]:
    def refuse(*_: object, **__: object) -> NoReturn:
        raise NotSimulated(name)

    return refuse


def _put_os() -> None:
    _put(
        os,
        {
            "pipe": files.pipe,
            "pipe2": files.pipe,
            "open": terminals.open_,
            "openpty": terminals.openpty,
            "eventfd": files.eventfd,
            "eventfd_read": files.eventfd_read,
            "eventfd_write": files.eventfd_write,
            "urandom": _urandom,
            "sched_setscheduler": lambda *_: None,
            "sched_setaffinity": lambda *_: None,
        },
    )
    ttyname, close = os.ttyname, os.close

    def close_any(descriptor: int) -> None:
        """Close a descriptor; whoever waits for a real one in the world is told."""
        if files.is_ours(descriptor):
            files.close(descriptor)
        else:
            files.forget_real(descriptor)
            close(descriptor)

    _put(os, {"close": close_any})
    of_descriptors: dict[str, Callable[..., Any]] = {
        "read": lambda fd, most: files.find(fd).read(most),
        "write": lambda fd, data: files.find(fd).write(data),
        "ttyname": lambda fd: ttyname(terminals.real_of(fd)),
        "fstat": terminals.status,
        "lseek": lambda *_: files.fail(errno.ESPIPE),
        "dup2": files.dup2,
        "get_inheritable": lambda fd: files.find(fd) is None,
        "isatty": terminals.isatty,
        "dup": files.dup,
        "set_blocking": lambda fd, flag: setattr(files.find(fd), "blocking", flag),
        "get_blocking": lambda fd: files.find(fd).blocking,
        "set_inheritable": lambda *_: None,
        "fdopen": files.fdopen,
    }
    of_descriptors |= {name: _refusal(f"os.{name}") for name in _REFUSED_OF_DESCRIPTORS.split()}
    for name, ours in of_descriptors.items():
        _put(os, {name: _for_descriptors(getattr(os, name), ours)})
    plain_open = io.open

    def open_any(file: Any, *rest: Any, **more: Any) -> Any:
        if terminals.is_terminal(file):
            raise NotSimulated("open() of a terminal by its name: use os.open")
        return (files.fdopen if files.is_ours(file) else plain_open)(file, *rest, **more)

    _put(io, {"open": open_any})
    _put(builtins, {"open": open_any})


def _enable_where_it_can(enable: Callable[..., None]) -> Callable[..., None]:
    """Return `faulthandler.enable`, for whoever asks with a standard error that has no descriptor.

    rclpy asks for it, also where pytest keeps what is printed.
    """

    def enabled(*given: Any, **more: Any) -> None:
        with contextlib.suppress(io.UnsupportedOperation):
            enable(*given, **more)

    return enabled


def _for_descriptors(theirs: Callable[..., Any], ours: Callable[..., Any]) -> Callable[..., Any]:
    """Return the system's function, or ours for a descriptor of a world."""

    def chosen(descriptor: Any, *rest: Any, **more: Any) -> Any:
        if running.kernel is not None and not isinstance(descriptor, int):
            descriptor = files.number_of(descriptor)
        return (ours if files.is_ours(descriptor) else theirs)(descriptor, *rest, **more)

    return chosen


def _put_terminals() -> None:
    for name in ("tcgetattr", "tcsetattr", "tcflush", "tcdrain", "tcsendbreak"):
        _put(termios, {name: _for_descriptors(getattr(termios, name), getattr(terminals, name))})
    _put(
        fcntl,
        {
            "ioctl": _for_descriptors(fcntl.ioctl, _ioctl),
            "flock": _for_descriptors(fcntl.flock, terminals.flock),
            "fcntl": _for_descriptors(fcntl.fcntl, terminals.fcntl_),
        },
    )


def _put_processes() -> None:
    """Import what stands on what is replaced by now, and replace processes and signals."""
    import signal
    import subprocess
    import threading

    from crtk_drivers.testing.world.machine import processes

    _put(subprocess, {"Popen": processes.Popen})
    _put(
        signal,
        {
            "signal": processes.set_handler,
            "getsignal": processes.get_handler,
            "raise_signal": processes.raise_signal,
            "set_wakeup_fd": processes.set_wakeup_fd,
        },
    )
    _put(os, {"kill": processes.kill, "_exit": processes.exit_now, "getpid": processes.getpid})
    _put(
        threading,
        {
            "main_thread": processes.main_thread,
            "enumerate": processes.threads,
            "active_count": processes.count_threads,
            "activeCount": processes.count_threads,
        },
    )
    _put(atexit, {"register": processes.at_exit, "unregister": processes.not_at_exit})
    sys.stdin, sys.stdout, sys.stderr = processes.standard


def _ioctl(descriptor: int, request: int, argument: Any = 0, mutate: bool = True) -> Any:
    found = files.find(descriptor).control(request, argument)
    if not isinstance(found, bytes) or isinstance(argument, bytes | int) or not mutate:
        return found
    memoryview(argument).cast("B")[: len(found)] = found
    return 0


# Numbers that are random elsewhere


def _urandom(size: int) -> bytes:
    kernel = running.kernel
    return bytes(size) if kernel is None else kernel.entropy.randbytes(size)


def _let_seeds_be_of_the_world() -> None:
    """Let a generator that nobody seeds be seeded by the world."""
    plain = random.Random.seed

    def seed(self: random.Random, a: Any = None, version: int = 2) -> None:
        kernel = running.kernel
        if a is None:
            a = 0 if kernel is None else kernel.entropy.getrandbits(64)
        plain(self, a, version)

    random.Random.seed = seed  # type: ignore[method-assign]
