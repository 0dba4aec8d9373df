"""Simulators, processes of the bench and commands are forked from one process that has imported them.

They start in a hundredth of a second. What a simulator costs before it does anything is Python, numpy and
its own modules: a tenth of a second of CPU, all at once, beside tests that keep time; a process of the bench
takes four, a driver on ROS eight. The fork has the arguments, the files, the environment, the folder and the
session that whoever starts it gives it, starts its own processes by this too, and ends as any Python program
does. Its parent is the process that forks. A test run that is killed leaves none of them behind: the kernel
kills what has lost its parent, which may be stopped or ignore other signals.
"""

from __future__ import annotations

import atexit
import ctypes
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
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import IO, Any, Self

from typing_extensions import override

MOST = 1 << 18
"""Bytes of a request: an environment and a path."""

FILES = 16
"""Files that a request may have."""

ANSWERED_WITHIN = 100.0
"""Seconds: at first, all of it is imported meanwhile, ten seconds of CPU, by all workers at once."""

SIMULATORS = "crtk_sim_backends"
"""What is imported at first."""

PROGRAMS = (
    "_pytest",
    "crtk_drivers.cli",
    "crtk_drivers.client",
    "crtk_drivers.front",
    "crtk_drivers.labs",
    "crtk_drivers.ros",
    "crtk_drivers.session",
)
"""What is imported before the first fork that is no simulator: who starts simulators alone does not wait."""

DRIVERS = (
    "crtk_driver_ati_netft",
    "crtk_driver_canopen",
    "crtk_driver_dynamixel",
    "crtk_driver_ur",
    "crtk_driver_virtual",
)
"""What is imported then, too; or one of them alone, if it is a driver that starts a process of its own."""


PR_SET_PDEATHSIG = 1  # linux/prctl.h


class Reader:
    """Reads the rest of a pipe, if there is one, so that whoever writes is never stopped."""

    def __init__(self, pipe: IO[Any] | None) -> None:
        self._pipe = pipe
        self._found: Any = None
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        if self._pipe is not None and self._thread is None:
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()

    def _run(self) -> None:
        assert self._pipe is not None
        self._found = self._pipe.read()

    def finish(self) -> Any:
        """Return what was read, and close the pipe."""
        if self._pipe is not None and self._thread is not None:
            self._thread.join()
            self._pipe.close()
        return self._found


class Process:
    """A forked program, as `subprocess.Popen` has it: the part that is used of it."""

    def __init__(
        self,
        pid: int,
        told: socket.socket,
        stdin: IO[Any] | None = None,
        stdout: IO[Any] | None = None,
        stderr: IO[Any] | None = None,
    ) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self.stdin = stdin
        self.stdout = stdout
        self.stderr = stderr
        self._readers = [Reader(pipe) for pipe in (stdout, stderr)]
        self._told = told  # readable when it has ended: how
        self._reading = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for pipe in (self.stdin, self.stdout, self.stderr):
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

    def communicate(self, timeout: float | None = None) -> tuple[Any, Any]:
        """Return all that it still writes until it ends."""
        if self.stdin is not None:
            self.stdin.close()
        for reader in self._readers:
            reader.begin()
        self.wait(timeout)
        out, errors = (reader.finish() for reader in self._readers)
        return out, errors

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
        peer: leads to such a process that is there already.
    """

    def __init__(self, peer: socket.socket | None = None) -> None:
        self._lock = threading.Lock()
        self._peer = peer
        self._process: subprocess.Popen[bytes] | None = None

    def _begin(self, *listening: socket.socket) -> socket.socket:
        self._peer, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        # What the kernel takes for the death of a parent is that of the thread which started the process.
        lasts = threading.current_thread() is threading.main_thread()
        with theirs:
            files = [each.fileno() for each in (theirs, *listening)]
            told = (os.getpid(), int(lasts), *files)
            self._process = subprocess.Popen(
                [sys.executable, "-P", __file__, *map(str, told)],
                stdin=subprocess.DEVNULL,
                pass_fds=files,
                start_new_session=True,
                # A fork has no thread but the one that forked; numpy would miss those of its own.
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
        return self._peer

    def begin_for_all(self, path: Path) -> None:
        """Start it, and let others `join` it at `path`, until this is closed."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
            listener.bind(str(path))
            listener.listen()
            self._begin(listener)

    def join(self, path: Path) -> None:
        """Have what is started forked by the process that `begin_for_all` has started."""
        self._peer = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._peer.connect(str(path))

    def start(
        self, module: str, arguments: Sequence[str], pass_fds: Sequence[int], errors: int
    ) -> Process:
        """Do what `crtk_sim_backends.process` does, and sooner."""
        taken = {1: 1, 2: errors, **{file: file for file in pass_fds}}
        return Process(*self._fork(module, arguments, taken))

    def start_program(
        self,
        module: str,
        arguments: Sequence[str],
        stdout: int | None,
        stderr: int | None,
        files: Sequence[int],
    ) -> Process:
        """Do what `crtk_drivers.labs.bench.programs` does, and sooner."""
        return self._start(module, arguments, stdout, stderr, {file: file for file in files}, "b")

    def start_child(self, module: str, arguments: Sequence[str], peer: int, output: int) -> Process:
        """Do what `crtk_drivers.kit.child_process` does, and sooner; its parent is this process."""
        taken = {1: output, 2: output, peer: peer}
        told = [str(peer), *arguments]
        return Process(*self._fork(module, told, taken, parent=os.getpid()))

    def start_text(
        self, module: str, *arguments: str, stdout: int | None = None, stderr: int | None = None
    ) -> Process:
        """Do what `rigs.programs` does, and sooner."""
        return self._start(module, arguments, stdout, stderr, {}, "")

    def start_command(
        self,
        otherwise: Callable[..., subprocess.Popen[bytes]],
        command: Sequence[str],
        log: int,
        folder: Path,
        environment: Mapping[str, str] | None,
        files: Sequence[int],
    ) -> Process | subprocess.Popen[bytes]:
        """Do what `crtk_drivers.labs.supervisor` does, and sooner, if it is a device that is started."""
        if not files:
            return otherwise(command, log, folder, environment, files)
        _, _, module, *arguments = command
        with open(os.devnull) as nothing:
            taken = {0: nothing.fileno(), 1: log, 2: log, **{file: file for file in files}}
            return Process(*self._fork(module, arguments, taken, folder, environment))

    def _start(
        self,
        module: str,
        arguments: Sequence[str],
        stdout: int | None,
        stderr: int | None,
        files: Mapping[int, int],
        mode: str,
    ) -> Process:
        order, stdin = os.pipe()
        ours: list[int | None] = []
        theirs: list[int] = []
        for number, where in ((1, stdout), (2, stderr)):
            read, write = os.pipe() if where == subprocess.PIPE else (None, where)
            ours.append(read)
            theirs.append(number if write is None else write)
        try:
            taken = {0: order, 1: theirs[0], 2: theirs[1], **files}
            pid, told = self._fork(module, arguments, taken)
        finally:
            os.close(order)
            for read, write in zip(ours, theirs, strict=True):
                if read is not None:
                    os.close(write)
        pipes = [None if read is None else os.fdopen(read, f"r{mode}") for read in ours]
        return Process(pid, told, os.fdopen(stdin, f"w{mode}"), *pipes)

    def _fork(
        self,
        module: str,
        arguments: Sequence[str],
        taken: Mapping[int, int],
        folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
        parent: int = 0,
    ) -> tuple[int, socket.socket]:
        """Ask for a process with files of this one, by their number there; return what tells how it ends.

        Where `parent` is given, the process is told that this is its parent, as long as it lives.
        """
        with self._lock:
            peer = self._peer or self._begin()
        request: dict[str, Any] = {
            "module": module,
            "arguments": arguments,
            "path": [folder for folder in sys.path if folder],
            "environment": dict(os.environ if environment is None else environment),
            "folder": str(folder or Path.cwd()),
            "files": [*taken, peer.fileno()],
            "peer": peer.fileno(),
            "parent": parent,
            "nice": os.getpriority(os.PRIO_PROCESS, 0),
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
        """End the process, if there is one, and with it what it has forked that still runs."""
        if self._peer is not None:
            self._peer.close()
        if self._process is not None:
            self._process.wait(10.0)


class ColdStart(WarmStart):
    """Starts programs as users do: in a world nothing can be forked."""

    @override
    def _start(
        self,
        module: str,
        arguments: Sequence[str],
        stdout: int | None,
        stderr: int | None,
        files: Mapping[int, int],
        mode: str,
    ) -> Any:
        return subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=stdout,
            stderr=stderr,
            pass_fds=list(files),
            text=not mode,
        )


@cache
def server() -> WarmStart:
    """Return that of this process."""
    from crtk_drivers.testing import world

    return ColdStart() if world.is_here() else WarmStart()


def number(told: socket.socket) -> int:
    """Wait for what the process that forks tells next: the process id, then how it ended."""
    data = told.recv(64)
    assert data, "the process that programs are forked from has ended"
    return int(data)


def die_with(parent: int) -> None:
    """Have the kernel kill this process when the thread that started it ends; end now if it has ended."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)


def serve(
    first: socket.socket, listener: socket.socket | None, parent: int
) -> dict[str, Any] | None:
    """Fork whatever is asked for.

    Returns the request in the fork, and None where `first` asks no more or `parent`, a pidfd, has ended.
    Forks keep `first` open: without the pidfd they would wait for this process, and it for them.
    """
    awakened, awake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(awake, warn_on_full_buffer=False)
    children: dict[int, socket.socket] = {}
    imported = {SIMULATORS}
    doors = [] if listener is None else [listener]
    peers = [first]
    if listener is not None:
        import_more({*PROGRAMS, *DRIVERS}, imported)
    while True:
        readable, _, _ = select.select([*doors, *peers, awakened, parent], [], [])
        if parent in readable:
            return None
        if awakened in readable:
            os.read(awakened, 4096)
            reap(children)
        peers.extend(door.accept()[0] for door in doors if door in readable)
        for peer in [each for each in peers if each in readable]:
            data, files, _, _ = socket.recv_fds(peer, MOST, FILES)
            if not data:
                if peer is first:
                    return None
                peers.remove(peer)
                peer.close()
                continue
            request: dict[str, Any] = json.loads(data)
            package = request["module"].partition(".")[0]
            alone = package in (SIMULATORS, *DRIVERS)
            import_more({package} if alone else {*PROGRAMS, *DRIVERS}, imported)
            descriptor, *files = files
            tell = socket.socket(fileno=descriptor)
            own = os.getpid()
            pid = os.fork()
            if pid == 0:
                die_with(own)
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                for unused in (awakened, awake, parent):
                    os.close(unused)
                for other in (*doors, *peers, tell, *children.values()):
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


def import_all(*names: str) -> None:
    """Import packages with all that is in them, but what is run; spare the collector to look at it."""
    for name in names:
        with suppress(ImportError):  # of an extra that is not installed
            package = importlib.import_module(name)
            for module in pkgutil.walk_packages(package.__path__, f"{name}."):
                if not module.name.endswith("__main__"):
                    with suppress(ImportError):
                        importlib.import_module(module.name)
    gc.freeze()


def import_more(needed: set[str], imported: set[str]) -> None:
    """Import what of `needed` is not `imported` yet."""
    if not needed <= imported:
        import_all(*sorted(needed - imported))
        imported |= needed


def main(parent: int, lasts: int, descriptor: int, *doors: int) -> None:
    """Fork until nobody asks any more or the parent has ended, and be the program in the fork.

    Args:
        parent: process id.
        lasts: whether the thread of the parent that has started this process is its main thread.
        descriptor: of the socket by which the parent asks.
        doors: of the socket where others come, if they may.
    """
    if lasts:
        die_with(parent)
    watched = os.pidfd_open(parent)
    import_all(SIMULATORS)
    listener = socket.socket(fileno=doors[0]) if doors else None
    request = serve(socket.socket(fileno=descriptor), listener, watched)
    if request is not None:
        os.nice(max(0, request["nice"] - os.getpriority(os.PRIO_PROCESS, 0)))
        start_by(WarmStart(socket.socket(fileno=request["peer"])))
        os.environ.clear()
        os.environ.update(request["environment"])
        os.chdir(request["folder"])
        sys.path[:] = request["path"]
        sys.argv[1:] = request["arguments"]
        if request["parent"]:
            os.getppid = partial(parent_of, request["parent"], os.getppid())
        run(request["module"])


LATE_THREAD = 4.0
"""Seconds, in place of half of one, that an I/O thread may be late: on a busy machine it may get no time."""
UNSEEN = 5.0
"""Seconds for which the bench may look at no device: what is shown by its tests needs no quiet machine."""


def start_by(warm: WarmStart) -> None:
    """Let this process start its own by the one that it is forked from, and have patience."""
    if watch := sys.modules.get("crtk_drivers.labs.bench.watch"):
        watch.BLIND = watch.OLDEST = UNSEEN  # type: ignore[attr-defined]
    if calls := sys.modules.get("crtk_drivers.labs.bench.calls"):
        calls.STANDS_STILL = UNSEEN  # type: ignore[attr-defined]
    if threads := sys.modules.get("crtk_drivers.engine.threads"):
        threads.STALL_LIMIT = LATE_THREAD  # type: ignore[attr-defined]
    for module, start in (
        ("crtk_sim_backends.process", warm.start),
        ("crtk_drivers.labs.bench.programs", warm.start_program),
        ("crtk_drivers.kit.child_process", warm.start_child),
    ):
        if module in sys.modules:
            sys.modules[module]._start = start  # type: ignore[attr-defined]
    if supervisor := sys.modules.get("crtk_drivers.labs.supervisor"):
        started = supervisor.start_process
        supervisor.start_process = partial(warm.start_command, started)  # type: ignore[attr-defined]


def parent_of(parent: int, otherwise: int) -> int:
    """Return who has asked for this process, and who has forked it when that has ended."""
    try:
        os.kill(parent, 0)
    except ProcessLookupError:
        return otherwise
    return parent


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
    main(*map(int, sys.argv[1:]))
