"""Simulators and the processes of the bench are forked from one that has imported them.

They start in a hundredth of a second. What a simulator costs before it does anything is Python, numpy and
its own modules: a tenth of a second of CPU, all at once, beside tests that keep time; a process of the bench
takes four. The fork has the arguments, the files, the environment, the folder and the session that
`crtk_sim_backends.process` and `crtk_drivers.labs.bench.programs` give it, starts its own processes by this
too, and ends as any Python program does. Its parent is the process that forks.
"""

from __future__ import annotations

import atexit
import fcntl
import gc
import importlib
import json
import os
import pkgutil
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import IO, Any, Self

MOST = 1 << 18
"""Bytes of a request: an environment and a path."""

FILES = 16
"""Files that a request may have."""

ANSWERED_WITHIN = 30.0
"""Seconds: at first, all of it is imported meanwhile."""

SIMULATORS = ("crtk_sim_backends",)
"""Packages of simulators."""

BENCH = (
    *SIMULATORS,
    "_pytest",
    "crtk_drivers.labs.bench",
    "crtk_driver_ati_netft",
    "crtk_driver_canopen",
    "crtk_driver_dynamixel",
    "crtk_driver_ur",
    "crtk_driver_virtual",
)
"""Those of a run of the bench, and of a lab's own tests."""


class Process:
    """A forked program, as `subprocess.Popen` has it: the part that is used of it."""

    def __init__(
        self,
        pid: int,
        told: socket.socket,
        stdin: IO[bytes] | None = None,
        stdout: IO[bytes] | None = None,
    ) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self.stdin = stdin
        self.stdout = stdout
        self._told = told  # readable when it has ended: how
        self._reading = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for pipe in (self.stdin, self.stdout):
            if pipe is not None:
                pipe.close()
        self.wait()

    def poll(self) -> int | None:
        return self._look(0.0)

    def wait(self, timeout: float | None = None) -> int:
        code = self._look(timeout)
        if code is None:
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        return code

    def _look(self, timeout: float | None) -> int | None:
        if self.returncode is None and self._has_told(timeout):
            with self._reading:
                if self.returncode is None:
                    with self._told:
                        self.returncode = number(self._told)
        return self.returncode

    def _has_told(self, timeout: float | None) -> bool:
        try:
            return bool(select.select([self._told], [], [], timeout)[0])
        except (OSError, ValueError):  # another thread has read it meanwhile, and closed it
            return True

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it has ended since
                os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


class WarmStart:
    """The process that programs are forked from, and how to ask it for one.

    Args:
        packages: that it imports.
        peer: leads to such a process that is there already.
    """

    def __init__(self, packages: Sequence[str], peer: socket.socket | None = None) -> None:
        self._packages = packages
        self._lock = threading.Lock()
        self._peer = peer

    def _begin(self) -> socket.socket:
        self._peer, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", __file__, str(theirs.fileno()), *self._packages],
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
                # A fork has no thread but the one that forked; numpy would miss those of its own.
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
        return self._peer

    def start(self, module: str, arguments: Sequence[str], pass_fds: Sequence[int]) -> Process:
        """Do what `crtk_sim_backends.process` does, and sooner."""
        return Process(*self._fork(module, arguments, {file: file for file in (1, 2, *pass_fds)}))

    def start_program(
        self,
        module: str,
        arguments: Sequence[str],
        stdout: int | None,
        stderr: int | None,
        files: Sequence[int],
    ) -> Process:
        """Do what `crtk_drivers.labs.bench.programs` does, and sooner."""
        order, stdin = os.pipe()
        answers, printed = os.pipe() if stdout == subprocess.PIPE else (None, stdout or 1)
        try:
            taken = {0: order, 1: printed, 2: stderr or 2, **{file: file for file in files}}
            pid, told = self._fork(module, arguments, taken)
        finally:
            os.close(order)
            if answers is not None:
                os.close(printed)
        return Process(
            pid,
            told,
            os.fdopen(stdin, "wb"),
            None if answers is None else os.fdopen(answers, "rb"),
        )

    def _fork(
        self, module: str, arguments: Sequence[str], taken: Mapping[int, int]
    ) -> tuple[int, socket.socket]:
        """Ask for a process with files of this one, by their number there; return what tells how it ends."""
        with self._lock:
            peer = self._peer or self._begin()
        request: dict[str, Any] = {
            "module": module,
            "arguments": arguments,
            "path": [folder for folder in sys.path if folder],
            "environment": dict(os.environ),
            "folder": os.getcwd(),
            "files": [*taken, peer.fileno()],
            "peer": peer.fileno(),
        }
        # Each request has its own way for answers: a test that ends while it waits leaves none to the next.
        told, tell = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        told.settimeout(ANSWERED_WITHIN)
        try:
            with tell, self._lock:
                files = [tell.fileno(), *taken.values(), peer.fileno()]
                socket.send_fds(peer, [json.dumps(request).encode()], files)
            return number(told), told
        except BaseException:
            told.close()
            raise

    def close(self) -> None:
        """End the process. What it has forked goes on, as long as the one for whom it was forked."""
        if self._peer is not None:
            self._peer.close()
            self._process.wait(10.0)


def number(told: socket.socket) -> int:
    """Wait for what the process that forks tells next: the process id, then how it ended."""
    data = told.recv(64)
    assert data, "the process that programs are forked from has ended"
    return int(data)


def serve(peer: socket.socket) -> dict[str, Any] | None:
    """Fork whatever is asked for. Return the request in the fork, and None where nobody asks any more."""
    awakened, awake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(awake, warn_on_full_buffer=False)
    children: dict[int, socket.socket] = {}
    while True:
        readable, _, _ = select.select([peer, awakened], [], [])
        if awakened in readable:
            os.read(awakened, 4096)
            reap(children)
        if peer not in readable:
            continue
        data, files, _, _ = socket.recv_fds(peer, MOST, FILES)
        if not data:
            return None
        request: dict[str, Any] = json.loads(data)
        descriptor, *files = files
        tell = socket.socket(fileno=descriptor)
        pid = os.fork()
        if pid == 0:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            for unused in (awakened, awake):
                os.close(unused)
            for other in (peer, tell, *children.values()):
                other.close()
            os.setsid()
            take(files, request["files"])
            return request
        children[pid] = tell
        for file in files:
            os.close(file)
        try:
            tell.send(str(pid).encode())
        except BrokenPipeError:  # whoever asked has gone
            os.kill(pid, signal.SIGKILL)


def reap(children: dict[int, socket.socket]) -> None:
    """Tell how those ended that have."""
    for pid in list(children):
        found, status = os.waitpid(pid, os.WNOHANG)
        if found:
            # Whoever asked may have gone.
            with children.pop(pid) as tell, suppress(BrokenPipeError):
                tell.send(str(os.waitstatus_to_exitcode(status)).encode())


def take(files: Sequence[int], numbers: Sequence[int]) -> None:
    """Give files the numbers that they had where they come from."""
    above = max(*files, *numbers) + 1
    moved = [fcntl.fcntl(file, fcntl.F_DUPFD_CLOEXEC, above) for file in files]
    for file in files:
        os.close(file)
    for file, number in zip(moved, numbers, strict=True):
        os.dup2(file, number)
        os.close(file)


def import_all(name: str) -> None:
    """Import a package with all that is in it, but what is run."""
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, f"{name}."):
        if not module.name.endswith("__main__"):
            with suppress(ImportError):  # of an extra that is not installed
                importlib.import_module(module.name)


def main(descriptor: int, packages: Sequence[str]) -> None:
    """Fork until nobody asks any more, and be the program in the fork."""
    for package in packages:
        import_all(package)
    gc.freeze()
    request = serve(socket.socket(fileno=descriptor))
    if request is not None:
        start_by(WarmStart(packages, socket.socket(fileno=request["peer"])))
        os.environ.clear()
        os.environ.update(request["environment"])
        os.chdir(request["folder"])
        sys.path[:] = request["path"]
        sys.argv[1:] = request["arguments"]
        run(request["module"])


def start_by(warm: WarmStart) -> None:
    """Let this process start its own by the one that it is forked from."""
    for module, start in (
        ("crtk_sim_backends.process", warm.start),
        ("crtk_drivers.labs.bench.programs", warm.start_program),
    ):
        if module in sys.modules:
            sys.modules[module]._start = start  # type: ignore[attr-defined]


def run(module: str) -> None:
    """Run a module as a program, and spare it to take apart all that was imported when it ends."""
    code = 1  # of a program that raises what it should not

    def leave() -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)

    atexit.register(leave)
    if not hasattr(sys.modules.get(module), "__path__"):
        sys.modules.pop(module, None)  # which is imported; nothing is, of a program that begins
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(bool(ended.code))
        raise


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
