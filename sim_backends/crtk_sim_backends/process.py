"""A simulator in its own process: started, proven ready, stopped, and never left behind."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import gc
import json
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self, TypeVar

from crtk_sim_backends.child_log import ChildLog
from crtk_sim_backends.control import ControlClient

AUTO: Final = "auto"

_REALTIME_PRIORITY: Final = 20
_PR_SET_TIMERSLACK: Final = 29
_KILLED_WITHIN: Final = 10.0

_RUN_MODULE: Final = (
    "import json, runpy, sys;"
    "module, path = sys.argv[1], json.loads(sys.argv[2]);"
    "del sys.argv[1:3];"
    "sys.path.extend(p for p in path if p not in sys.path);"
    "runpy.run_module(module, run_name='__main__', alter_sys=True)"
)

Bound = TypeVar("Bound")

log = logging.getLogger(__name__)


class SimStartError(RuntimeError):
    """A simulator could not be started: address in use, wrong option, or no answer in time."""


class AddressInUseError(SimStartError):
    """A port of the address is held by somebody else."""


def listen(
    host: str, port: int, name: str, way_out: str = "choose another 127.x.y.z address"
) -> socket.socket:
    """Open a non-blocking listening socket.

    Args:
        host: address to bind; the caller keeps to loopback addresses.
        port: TCP port, 0 for any free one.
        name: what the port is for, for the error message.
        way_out: what else can be done when the port is in use.

    Raises:
        AddressInUseError: when another process holds the port.
        SimStartError: when the address cannot be bound at all.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
        sock.listen(16)
    except OSError as error:
        sock.close()
        raise _not_bound(error, host, port, name, way_out, "-ltnp") from error
    sock.setblocking(False)
    return sock


def bind_udp(
    host: str, port: int, name: str, way_out: str = "choose another 127.x.y.z address"
) -> socket.socket:
    """Open a non-blocking socket for datagrams; arguments and errors are those of `listen`."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        raise _not_bound(error, host, port, name, way_out, "-lunp") from error
    sock.setblocking(False)
    return sock


def _not_bound(
    error: OSError, host: str, port: int, name: str, way_out: str, listed_by: str
) -> SimStartError:
    what = f"cannot bind the {name} port {host}:{port}"
    if error.errno == errno.EADDRINUSE:
        return AddressInUseError(
            f"{what}: it is in use, perhaps by another simulator or a vendor simulator that binds "
            f"every address; `ss {listed_by} 'sport = :{port}'` names the process. Stop it, or "
            f"{way_out}."
        )
    if error.errno == errno.EACCES:
        return SimStartError(
            f"{what}: ports below 1024 need privilege; give another one with {name}_port, run as "
            f"root, or permit it with `sudo sysctl net.ipv4.ip_unprivileged_port_start={port}`"
        )
    return SimStartError(
        f"{what}: {error.strerror}; choose an address of this machine, such as 127.0.0.2 (macOS: "
        "`sudo ifconfig lo0 alias 127.0.0.2` first)"
    )


def listen_in_files(path: Path) -> socket.socket:
    """Open a non-blocking listening socket in the file system; a file that is there is replaced.

    Raises:
        SimStartError: it cannot be made.
    """
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        path.unlink(missing_ok=True)
        sock.bind(str(path))
        sock.listen(16)
    except OSError as error:
        sock.close()
        raise SimStartError(f"cannot make the socket {path}: {error.strerror}") from error
    sock.setblocking(False)
    return sock


def loopback_addresses(seed: int, count: int = 50) -> Iterator[str]:
    """Addresses of 127.0.0.0/8 to try, a different sequence for each `seed` (a process id)."""
    for attempt in range(count):
        number = (seed * 2_654_435_761 + attempt * 40_503) % (127 * 254 * 254)
        second, rest = divmod(number, 254 * 254)
        third, fourth = divmod(rest, 254)
        yield f"127.{second + 128}.{third + 1}.{fourth + 1}"


def bind_somewhere(host: str, bind: Callable[[str], Bound]) -> tuple[str, Bound]:
    """Bind at `host`, or at the first free loopback address when `host` is "auto".

    `bind` binds every port of the simulator at the address that it is given, or raises
    AddressInUseError with nothing left bound.
    """
    if host != AUTO:
        return host, bind(host)
    last: AddressInUseError | None = None
    for address in loopback_addresses(os.getpid()):
        try:
            return address, bind(address)
        except AddressInUseError as error:
            last = error
    raise SimStartError(f"no free loopback address found, the last try: {last}")


def use_realtime_priority() -> None:
    """Run this process with SCHED_FIFO if the system permits it; a warning tells when it does not."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_REALTIME_PRIORITY))
    except (AttributeError, OSError) as error:
        log.warning("no real-time priority, the periods may be less even: %s", error)


def use_exact_timers() -> None:
    """Let this process wake up when it asked for it, and not up to 50 us later (Linux)."""
    if sys.platform == "linux":
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0) != 0:
            log.warning("timers stay coarse: %s", os.strerror(ctypes.get_errno()))


def prepare_process(*, realtime: bool = False) -> None:
    """Give this process exact timers, priority if it wants it, and nothing to tidy up while it runs."""
    use_exact_timers()
    if realtime:
        use_realtime_priority()
    gc.collect()
    gc.freeze()


class Readiness:
    """Child side of :func:`spawn`: the two pipes to the parent, as file descriptors or None."""

    def __init__(self, ready_fd: int | None, parent_fd: int | None) -> None:
        self._ready_fd = ready_fd
        self.parent_fd = parent_fd  # becomes readable when the parent has died

    def tell(self, **values: Any) -> None:
        """Tell the parent, once, that all is bound, or what went wrong.

        `host` and `ports`; if there are any `ttys`, `paths` and `hints`. Or the `error`.
        """
        if self._ready_fd is None:
            return
        with contextlib.suppress(BrokenPipeError):
            os.write(self._ready_fd, json.dumps(values).encode())
        os.close(self._ready_fd)
        self._ready_fd = None


class RunningSim:
    """A simulator in its own process. A context manager; `stop` it when done."""

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        life: int,
        said: ChildLog,
        host: str,
        ports: Mapping[str, int],
        ttys: Mapping[str, str],
        paths: Mapping[str, str],
        hints: Sequence[str],
    ) -> None:
        self._process = process
        self._life = life
        self._said = said
        self._control: ControlClient | None = None
        self._connecting = threading.Lock()
        self.host = host
        self.ports = dict(ports)
        self.ttys = dict(ttys)
        self.paths = dict(paths)  # of Unix sockets
        self.hints = tuple(hints)  # for a person: how programs connect, line by line

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def control(self) -> ControlClient:
        """Client of its control socket, connected at the first use, and anew after no answer. Thread-safe."""
        with self._connecting:
            if self._control is not None and self._control.lost:
                self._control.close()
                self._control = None
            if self._control is None:
                self._control = ControlClient(self.host, self.ports["control"])
            return self._control

    @property
    def running(self) -> bool:
        """Whether the process lives."""
        return self._process.poll() is None

    def suspend(self) -> None:
        """Freeze the whole process (SIGSTOP), as a machine that hangs does."""
        self._process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let a frozen process go on."""
        self._process.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        """End the process at once (SIGKILL), as a power cut does."""
        self._process.kill()
        self._finish(2.0)

    def stop(self, timeout: float = 2.0) -> int:
        """End the process and return its exit code (0 when it ended as asked); safe to repeat."""
        if self.running:
            self._process.terminate()
            self._process.send_signal(signal.SIGCONT)
        return self._finish(timeout)

    def _finish(self, timeout: float) -> int:
        if self._control is not None:
            self._control.close()
            self._control = None
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait(_KILLED_WITHIN)
        self._said.join()
        if self._life >= 0:
            os.close(self._life)
            self._life = -1
        return code

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def __del__(self) -> None:
        if self._life >= 0 and self.running:
            text = (
                f"the simulator with process id {self.pid} was forgotten, not stopped: it goes on. "
                "Stop it, or use it in a with statement."
            )
            warnings.warn(text, ResourceWarning, stacklevel=2, source=self)


def spawn(
    module: str,
    arguments: Sequence[str],
    timeout: float = 60.0,
    pass_fds: Sequence[int] = (),
    called: str = "",
) -> RunningSim:
    """Start the simulator `module` (``python -m module``) and wait until its ports are bound.

    The process finds the same packages as this one, has the files `pass_fds`, and ends when this one dies.
    What it writes to standard error is logged here.

    Args:
        module: that is run.
        arguments: of its command line.
        timeout: seconds in which it is ready.
        pass_fds: files that it has, too.
        called: what stands before its log records; the module if left out.

    Raises:
        SimStartError: with the reason that the child gave, or when it said nothing in `timeout`.
    """
    ready_read, ready_write = os.pipe()
    life_read, life_write = os.pipe()
    errors_read, errors_write = os.pipe()
    pipes = ["--ready-fd", str(ready_write), "--parent-fd", str(life_read)]
    files = (ready_write, life_read, *pass_fds)
    try:
        process = _start(module, [*arguments, *pipes], files, errors_write)
    except OSError as error:
        for ours in (ready_read, life_write, errors_read):
            os.close(ours)
        raise SimStartError(f"cannot start {sys.executable}: {error}") from error
    finally:
        for theirs in (ready_write, life_read, errors_write):
            os.close(theirs)
    said = ChildLog(called or module, errors_read)
    try:
        answer = _read_answer(ready_read, timeout)
    finally:
        os.close(ready_read)
    if "host" in answer:
        return RunningSim(
            process,
            life_write,
            said,
            answer["host"],
            answer["ports"],
            answer.get("ttys", {}),
            answer.get("paths", {}),
            answer.get("hints", ()),
        )
    if answer.get("timeout"):
        process.kill()
    code = process.wait()
    said.join()
    os.close(life_write)
    reason = answer.get("error") or (
        f"{module} was not ready within {timeout:g} s"
        if answer.get("timeout")
        else f"{module} ended with exit code {code} before it was ready; its last words: {said.last}"
    )
    raise SimStartError(reason)


def _start(
    module: str, arguments: Sequence[str], pass_fds: Sequence[int], errors: int
) -> subprocess.Popen[bytes]:
    path = json.dumps([p for p in sys.path if p])
    return subprocess.Popen(
        [sys.executable, "-P", "-c", _RUN_MODULE, module, path, *arguments],
        stdin=subprocess.DEVNULL,
        stderr=errors,
        pass_fds=pass_fds,
        start_new_session=True,  # Ctrl-C is for the client, which stops the simulator last
    )


def _read_answer(fd: int, timeout: float) -> dict[str, Any]:
    deadline = time.monotonic() + timeout
    data = b""
    poll = select.poll()  # which takes any descriptor: this is the process of who starts it
    poll.register(fd, select.POLLIN)
    while True:
        if not poll.poll(1000.0 * max(0.0, deadline - time.monotonic())):
            return {"timeout": True}
        piece = os.read(fd, 65536)
        if not piece:
            answer: dict[str, Any] = json.loads(data) if data else {}
            return answer
        data += piece
