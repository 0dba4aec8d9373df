"""Child processes and signals of a world, in place of `subprocess.Popen` and functions of `os` and `signal`.

A child is a Python program (``-c`` or ``-m``) that runs in threads of this interpreter. It has its own
command line, descriptors, main thread and signal handlers. It shares the imported modules, and so their
variables, with every other process of the world.
"""

from __future__ import annotations

import builtins
import concurrent.futures.thread
import contextlib
import errno
import functools
import os
import runpy
import shutil
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from typing import Any, Final, TextIO

from typing_extensions import override

from crtk_drivers.testing.world.machine import files
from crtk_drivers.testing.world.machine.kernel import NotSimulated, Process, here, running

_real_getpid, _real_signal, _real_getsignal = os.getpid, signal.signal, signal.getsignal
_real_main_thread, _real_threads = threading.main_thread, threading.enumerate
_real_outputs: Final = (sys.stdin, sys.stdout, sys.stderr)
_IGNORED: Final = (signal.SIGCHLD, signal.SIGWINCH, signal.SIGURG)
_OPTIONS_WITH_VALUE: Final = ("-X", "-W")
_REFUSED: Final = ("executable", "preexec_fn", "cwd", "shell", "gid", "gids", "uid", "umask")
"""Arguments of `_execute_child` that would change what the child is."""
_PIPES: Final = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")
_EXECUTED: Final = (
    *("args", "executable", "preexec_fn", "close_fds", "pass_fds", "cwd", "env", "startupinfo"),
    *("creationflags", "shell", *_PIPES, "restore_signals", "gid", "gids", "uid", "umask"),
)
"""What Python gives to `_execute_child`, in this order."""
_UNSET: Final = (None, False, -1)


class Popen(subprocess.Popen[Any]):
    """As `subprocess.Popen`, of a Python program.

    Raises:
        NotSimulated: it is another program, or an argument asks for what a world does not have.
    """

    _process: Process

    def _execute_child(self, *given: Any) -> None:
        """Start the child; Python's own makes the pipes before, and reads and writes them after."""
        asked = dict(zip(_EXECUTED, given, strict=False))
        for name in _REFUSED:
            if asked[name] not in _UNSET:
                raise NotSimulated(f"subprocess.Popen({name}={asked[name]!r})")
        args = asked["args"]  # the environment is one for all
        if isinstance(args, str | bytes | os.PathLike):
            args = [args]
        main, argv = _program([os.fspath(each) for each in args])
        kernel = here()
        child = kernel.add_process(argv[0], argv)
        child.parent = kernel.process
        child.standard = standard
        child.handlers.update(
            {n: each for n, each in kernel.process.handlers.items() if each == signal.SIG_IGN}
        )
        ends = [(int(each), int(each)) for each in asked["pass_fds"]]
        ends += list(enumerate((asked["p2cread"], asked["c2pwrite"], asked["errwrite"])))
        for number, source in ends:
            found = _inherited(number if source == -1 else source)
            if found is not None:
                found.hold()
                child.files[number] = found
        self._process = child
        self._child_created = True
        self.pid = child.pid
        child.main = kernel.start("main", lambda _: run_main(main), child)
        pipes = [asked[name] for name in _PIPES]
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]
        kernel.preempt()

    def _internal_poll(self, *_: object) -> int | None:
        if self.returncode is None and self._process.exit_code is not None:
            self.returncode = self._process.exit_code
            self._process.is_reaped = True
        return self.returncode

    @override
    def poll(self) -> int | None:
        here().preempt()
        return self._internal_poll()

    def _wait(self, timeout: float | None) -> int:
        kernel = here()
        end = None if timeout is None else kernel.deadline(max(0.0, timeout))
        while self._internal_poll() is None:
            if end is not None and kernel.now >= end:
                assert timeout is not None
                raise subprocess.TimeoutExpired(self.args, timeout)
            kernel.wait((self._process.exited,), end)
        return self.returncode

    @override
    def __del__(self) -> None:
        """Do nothing: a child of a world needs no burial."""


def _inherited(descriptor: int) -> files.OpenFile | None:
    """Return what a child has of its parent's descriptor, None if that is the real one of all."""
    if files.is_ours(descriptor):
        return files.find(descriptor)
    return files.RealOutput(descriptor) if descriptor > 2 else None


def _program(args: list[str]) -> tuple[Callable[[], object], list[str]]:
    """Return what a command line of Python runs, and its ``sys.argv``."""
    program, *rest = args
    if program != sys.executable:
        if shutil.which(program) is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), program)
        raise NotSimulated(f"the program {program}")
    while rest and rest[0].startswith("-") and rest[0] not in ("-c", "-m"):
        del rest[: 2 if rest[0] in _OPTIONS_WITH_VALUE else 1]
    if len(rest) < 2 or rest[0] not in ("-c", "-m"):
        raise NotSimulated(f"a program that is given neither by -c nor by -m: {' '.join(args)}")
    kind, what, *arguments = rest
    if kind == "-m":
        run = functools.partial(runpy.run_module, what, run_name="__main__", alter_sys=True)
        return run, [what, *arguments]
    code = compile(what, "<string>", "exec")
    space = {"__name__": "__main__", "__builtins__": builtins}
    return lambda: exec(code, space), ["-c", *arguments]


def run_main(main: Callable[[], object]) -> None:
    """Be the main task of a process."""
    process = here().process
    be_main_thread(process)
    code = _code_of(main)
    for task in list(here().tasks):
        thread = task.thread
        is_pooled = thread in concurrent.futures.thread._threads_queues  # noqa: SLF001 - nobody ends it
        is_ours = task.process is process and isinstance(thread, threading.Thread)
        if is_ours and not is_pooled and not thread.daemon:
            thread.join()
    while process.at_exit:
        code = _code_of(process.at_exit.pop()) or code
    with contextlib.suppress(OSError):
        for each in _outputs.get(process.pid, {}).values():
            each.flush()
    here().end_process(process, code)


def _code_of(main: Callable[[], object]) -> int:
    """Run a program, and return its exit code."""
    process = here().process
    try:
        main()
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return (end.code or 0) & 0xFF
        sys.stderr.write(f"{end.code}\n")
        return 1
    except KeyboardInterrupt:
        return -signal.SIGINT
    except BaseException:
        here().find("a process died", f"{process.name}: {traceback.format_exc()}")
        return 1
    return 0


# Threads of one process


def be_main_thread(process: Process) -> None:
    """Let this thread be the main one of a process."""
    is_first = not here().process.parent and process.pid == here().processes[0].pid
    if is_first:
        threading._active.pop(_real_main_thread().ident, None)  # type: ignore[attr-defined]  # noqa: SLF001
    thread: Any = threading.current_thread()  # a dummy, since no `Thread` has started it
    thread.__class__ = threading._MainThread  # type: ignore[attr-defined]  # noqa: SLF001
    thread._daemonic = False  # noqa: SLF001
    thread.name = "MainThread"
    if hasattr(thread, "_set_tstate_lock"):
        thread._set_tstate_lock()  # noqa: SLF001 - to Python 3.12, it can be joined by this
    process.main_thread = thread


def main_thread() -> Any:
    """As `threading.main_thread`: that of this process."""
    return _real_main_thread() if running.kernel is None else here().process.main_thread


def threads() -> list[threading.Thread]:
    """As `threading.enumerate`: those of this process."""
    kernel = running.kernel
    if kernel is None:
        return _real_threads()
    process = kernel.process
    ours = {id(task.thread) for task in kernel.tasks if task.process is process}
    return [each for each in _real_threads() if each is process.main_thread or id(each) in ours]


def count_threads() -> int:
    """As `threading.active_count`."""
    return len(threads())


# Standard input and outputs


_outputs: dict[int, dict[int, TextIO]] = {}


class Standard:
    """Python's file of descriptor 0, 1 or 2, of whichever process asks."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file(), name)

    def __iter__(self) -> Any:
        return iter(self._file())

    def _file(self) -> TextIO:
        number = self._number
        if running.kernel is None or number not in running.kernel.process.files:
            return _real_outputs[number]
        own = _outputs.setdefault(here().process.pid, {})
        if number not in own:
            buffering = 1 if number == 2 else -1
            own[number] = files.fdopen(number, "w" if number else "r", buffering, closefd=False)
        return own[number]


standard: Final[Any] = tuple(map(Standard, range(3)))
"""What `sys` has of a process that replaces nothing."""


def at_exit(function: Callable[..., Any], *args: Any, **more: Any) -> Callable[..., Any]:
    """As `atexit.register`, for this process; what is registered before the world begins is dropped."""
    if running.kernel is not None:
        running.kernel.process.at_exit.append(functools.partial(function, *args, **more))
    return function


def not_at_exit(function: Callable[..., Any]) -> None:
    """As `atexit.unregister`."""
    if running.kernel is not None:
        kept = running.kernel.process.at_exit
        kept[:] = [each for each in kept if getattr(each, "func", None) != function]


# Signals


_DEFAULTS: Final[Mapping[int, Any]] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGPIPE: signal.SIG_IGN,
    signal.SIGXFSZ: signal.SIG_IGN,
}
"""Those that Python itself sets when a program begins."""


def send_signal(process: Process, number: int) -> None:
    """Do what a signal does to a process."""
    kernel = here()
    kernel.note("signal", process.name, int(number))
    if not process.alive or not number:
        return
    if process.is_stopped and number not in (signal.SIGKILL, signal.SIGCONT):
        if number != signal.SIGSTOP:
            process.delayed.append(number)
        return
    handler = _handler(process, number)
    if number == signal.SIGKILL or (handler == signal.SIG_DFL and number not in _SPARED):
        kernel.end_process(process, -int(number))
    elif number == signal.SIGSTOP:
        process.is_stopped = True
        kernel.freeze(process, float("inf"))
    elif number == signal.SIGCONT:
        _go_on(process)
    elif callable(handler):
        process.handlers[number] = handler
        kernel.send_signal(process, number)
    if kernel.current is not None and kernel.current is process.main:
        kernel.give_way()  # who sends a signal to itself has handled it when it goes on
    kernel.preempt()


def _go_on(process: Process) -> None:
    if process.is_stopped:
        process.is_stopped = False
        here().thaw(process)
    delayed, process.delayed = process.delayed, []
    for number in delayed:
        send_signal(process, number)


_SPARED: Final = {*_IGNORED, signal.SIGSTOP, signal.SIGCONT}
"""Signals that do not end a process by themselves."""


def _handler(process: Process, number: int) -> Any:
    return process.handlers.get(number, _DEFAULTS.get(number, signal.SIG_DFL))


def set_handler(number: int, handler: Any) -> Any:
    """As `signal.signal`.

    Raises:
        NotSimulated: a handler of SIGCHLD: no process is told that a child has ended.
    """
    kernel = running.kernel
    if kernel is None:
        return _real_signal(number, handler)
    process = kernel.process
    if kernel.current is not process.main:
        raise ValueError("signal only works in main thread of the main interpreter")
    if not 1 <= number < signal.NSIG:
        raise ValueError("signal number out of range")
    if not callable(handler) and handler not in (signal.SIG_IGN, signal.SIG_DFL):
        raise TypeError(
            "signal handler must be signal.SIG_IGN, signal.SIG_DFL, or a callable object"
        )
    if number in (signal.SIGKILL, signal.SIGSTOP):
        files.fail(errno.EINVAL)
    if number == signal.SIGCHLD and handler not in (signal.SIG_IGN, signal.SIG_DFL):
        raise NotSimulated("a handler of SIGCHLD")
    before = _handler(process, number)
    process.handlers[number] = handler if callable(handler) else signal.Handlers(handler)
    return before


def get_handler(number: int) -> Any:
    """As `signal.getsignal`."""
    kernel = running.kernel
    return _real_getsignal(number) if kernel is None else _handler(kernel.process, number)


def kill(pid: int, number: int) -> None:
    """As `os.kill`.

    Raises:
        ProcessLookupError: no process of the world has this id.
    """
    for process in here().processes:
        if process.pid == pid and not process.is_reaped:
            send_signal(process, number)
            return
    files.fail(errno.ESRCH)


def raise_signal(number: int) -> None:
    """As `signal.raise_signal`."""
    send_signal(here().process, number)


def set_wakeup_fd(descriptor: int, **_: object) -> int:
    """As `signal.set_wakeup_fd`, for one who wants none: asyncio says so after each fork."""
    if descriptor != -1:
        raise NotSimulated("signal.set_wakeup_fd")
    return -1


def exit_now(code: int) -> None:
    """As `os._exit`."""
    here().end_process(here().process, code & 0xFF)


def getpid() -> int:
    """As `os.getpid`."""
    return _real_getpid() if running.kernel is None else here().process.pid


__all__ = [
    "Popen",
    "at_exit",
    "be_main_thread",
    "count_threads",
    "exit_now",
    "get_handler",
    "getpid",
    "kill",
    "main_thread",
    "not_at_exit",
    "raise_signal",
    "run_main",
    "set_handler",
    "set_wakeup_fd",
    "standard",
    "threads",
]
