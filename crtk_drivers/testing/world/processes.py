"""Child processes and signals of a world, in place of `subprocess.Popen` and functions of `os` and `signal`.

A child is a Python program (``-c`` or ``-m``) that runs in threads of this interpreter. It has its own
command line, descriptors, main thread and signal handlers. It shares the imported modules, and so their
variables, with every other process of the world.
"""

from __future__ import annotations

import builtins
import functools
import os
import runpy
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Self

from crtk_drivers.testing.world import files
from crtk_drivers.testing.world.kernel import NotSimulated, Process, here, running

_real_getpid, _real_signal, _real_getsignal = os.getpid, signal.signal, signal.getsignal
_real_main_thread = threading.main_thread
_IGNORED: Final = (signal.SIGCHLD, signal.SIGWINCH, signal.SIGURG)
_OPTIONS_WITH_VALUE: Final = ("-X", "-W")
_ACCEPTED: Final = {"close_fds", "start_new_session", "stdin", "text", "bufsize"}
"""Arguments of Popen that change nothing here."""


class Popen:
    """As `subprocess.Popen`, of a Python program.

    Raises:
        NotSimulated: it is another program, or an argument asks for what a world does not have.
    """

    def __init__(
        self,
        args: Sequence[str],
        *,
        stdout: Any = None,
        stderr: Any = None,
        pass_fds: Sequence[int] = (),
        env: Mapping[str, str] | None = None,
        **other: Any,
    ) -> None:
        for name, value in other.items():
            if name not in _ACCEPTED and value is not None:
                raise NotSimulated(f"subprocess.Popen({name}={value!r})")
        if subprocess.PIPE in (stdout, stderr, other.get("stdin")):
            raise NotSimulated("subprocess.PIPE: make a pipe by os.pipe, and pass its end")
        del env  # there is one environment for all
        self.args = args
        main, argv = _program([os.fspath(each) for each in args])
        kernel = here()
        self._process = kernel.add_process(argv[0], argv)
        ends = [(each, each) for each in pass_fds] + [(1, stdout), (2, stderr)]
        for number, given in ends:
            if files.is_ours(given):
                found = files.find(given)
                found.hold()
                self._process.files[number] = found
        self._process.main = kernel.start("main", lambda _: run_main(main), self._process)
        self.pid = self._process.pid
        self.stdin = self.stdout = self.stderr = None

    def __class_getitem__(cls, item: object) -> type[Self]:
        return cls

    @property
    def returncode(self) -> int | None:
        """Its exit code, None while it runs."""
        return self._process.exit_code

    def poll(self) -> int | None:
        """Return its exit code, None while it runs."""
        here().preempt()
        return self._process.exit_code

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end.

        Raises:
            subprocess.TimeoutExpired: it runs on.
        """
        kernel = here()
        end = kernel.deadline(timeout)
        while self._process.exit_code is None:
            if end is not None and kernel.now >= end:
                assert timeout is not None
                raise subprocess.TimeoutExpired(list(self.args), timeout)
            kernel.wait((self._process.exited,), end)
        return self._process.exit_code

    def send_signal(self, number: int) -> None:
        """Send it a signal."""
        send_signal(self._process, number)

    def terminate(self) -> None:
        """Send it SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send it SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.wait()


def _program(args: list[str]) -> tuple[Callable[[], object], list[str]]:
    """Return what a command line of Python runs, and its ``sys.argv``."""
    program, *rest = args
    if program != sys.executable:
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
    process.main_thread = threading.current_thread()
    process.main_thread.name = "MainThread"
    try:
        main()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        code = 1
        here().find("a process died", f"{process.name}: {traceback.format_exc()}")
    here().end_process(process, code)


def main_thread() -> Any:
    """As `threading.main_thread`: that of this process."""
    return _real_main_thread() if running.kernel is None else here().process.main_thread


# Signals


def send_signal(process: Process, number: int) -> None:
    """Do what a signal does to a process."""
    kernel = here()
    kernel.note("signal", process.name, int(number))
    handler = process.handlers.get(number, signal.SIG_DFL)
    if number == signal.SIGKILL or (handler == signal.SIG_DFL and number not in _SPARED):
        kernel.end_process(process, -int(number))
    elif number == signal.SIGSTOP:
        kernel.freeze(process, float("inf"))
    elif number == signal.SIGCONT:
        kernel.thaw(process)
    elif callable(handler):
        kernel.send_signal(process, number)
    kernel.preempt()


_SPARED: Final = {*_IGNORED, signal.SIGSTOP, signal.SIGCONT, 0}
"""Signals that do not end a process by themselves."""


def set_handler(number: int, handler: Any) -> Any:
    """As `signal.signal`."""
    kernel = running.kernel
    if kernel is None:
        return _real_signal(number, handler)
    before = kernel.process.handlers.get(number, signal.SIG_DFL)
    kernel.process.handlers[number] = handler
    return before


def get_handler(number: int) -> Any:
    """As `signal.getsignal`."""
    kernel = running.kernel
    if kernel is None:
        return _real_getsignal(number)
    return kernel.process.handlers.get(number, signal.SIG_DFL)


def kill(pid: int, number: int) -> None:
    """As `os.kill`.

    Raises:
        ProcessLookupError: no process of the world has this id.
    """
    for process in here().processes:
        if process.pid == pid and process.alive:
            return send_signal(process, number)
    raise ProcessLookupError(f"no process {pid} in the world")


def exit_now(code: int) -> None:
    """As `os._exit`."""
    here().end_process(here().process, code)


def getpid() -> int:
    """As `os.getpid`."""
    return _real_getpid() if running.kernel is None else here().process.pid


__all__ = ["Popen", "exit_now", "get_handler", "getpid", "kill", "main_thread", "set_handler"]
