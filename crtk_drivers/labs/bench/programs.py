"""The processes of a run: each is a module of this package, with its order on standard input."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

_THAW: Final = ("/bin/sh", "-c", 'read _; kill -CONT "$1"', "thaw")
"""Lets a process go on once its own standard input is closed."""


@contextmanager
def frozen(pid: int) -> Iterator[None]:
    """Within, a process gets no time. It goes on at the end, also where that comes by ``kill -9``."""
    command = (*_THAW, str(pid))
    with subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True) as thaw:
        assert thaw.stdin is not None
        os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(pid, signal.SIGCONT)
            thaw.stdin.close()


def is_stopped(pid: int) -> bool:
    """Whether a process was stopped by a signal or a debugger, as the kernel tells it (Linux)."""
    with contextlib.suppress(OSError):
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        return state in ("T", "t")
    return False


def start(
    module: str,
    *arguments: str,
    order: object = None,
    log: int | None = None,
    answers: bool = False,
    files: Sequence[int] = (),
) -> subprocess.Popen[bytes]:
    """Start a module as a program, in a session of its own: Ctrl-C is for whoever starts it.

    Args:
        module: its name.
        arguments: of it.
        order: what it takes from its standard input, pickled; None: that stays open.
        log: descriptor for what it prints; None: where this process prints.
        answers: what it prints is no log: a pipe leads to here.
        files: descriptors that it has too.
    """
    process = _start(module, arguments, subprocess.PIPE if answers else log, log, files)
    if order is not None:
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # that it does nothing is seen
            process.stdin.write(pickle.dumps(order))
            process.stdin.close()
    return process


def _start(
    module: str,
    arguments: Sequence[str],
    stdout: int | None,
    stderr: int | None,
    files: Sequence[int],
) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", module, *arguments],
        stdin=subprocess.PIPE,
        stdout=stdout,
        stderr=stderr,
        pass_fds=files,
        start_new_session=True,
    )
