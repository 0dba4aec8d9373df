"""A process of its own for a vendor's library, which may hang, crash or hold Python's lock there.

`ChildProcess` is the driver's side, `Parent` the child's. Between both goes a socket of whole messages.
The child ends when the driver does: the socket closes. What the hardware does then is the child's to see
to before it goes, and the hardware's own where the child is killed.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit.readable_files import is_readable

__all__ = ["ChildProcess", "Parent", "Spawned", "spawn"]

LONGEST: Final = 65_536
"""Bytes of a message."""
_LAST_WORDS: Final = 10
"""Lines that are kept of what the child, or the library, writes."""
_PIPES: Final = 4
"""How often a pipe is emptied at once: a library that writes without an end keeps nobody."""
_DIES: Final = 5.0
"""s in which a process that is killed is gone."""
_TELLS_HOW: Final = 0.2
"""Seconds in which the system tells how a process ended that has closed its socket."""


class Spawned(NamedTuple):
    """A process, and what leads to it.

    Attributes:
        process: it.
        peer: our end of a socket of whole messages, which does not block.
        errors: descriptor of what it writes, which does not block; to be closed.
    """

    process: subprocess.Popen[bytes]
    peer: socket.socket
    errors: int


def spawn(module: str, *arguments: str, called: str, where: str) -> Spawned:
    """Start ``python -m MODULE DESCRIPTOR ...``, where the descriptor is of the process' end of the socket.

    Args:
        module: that runs.
        arguments: behind the descriptor.
        called: how the process is called, for the message.
        where: the device, for the message.

    Raises:
        ConnectionFailed: the system refuses; nothing is left open.
    """
    with contextlib.ExitStack() as ours_if_it_fails, contextlib.ExitStack() as theirs_only:
        try:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            ours_if_it_fails.enter_context(ours)
            theirs_only.enter_context(theirs)
            ours.setblocking(False)
            errors, its_errors = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)
            ours_if_it_fails.callback(os.close, errors)
            theirs_only.callback(os.close, its_errors)
            process = _start(module, arguments, theirs.fileno(), its_errors)
        except OSError as error:
            raise ConnectionFailed(
                f"{called} cannot be started: {error}",
                where=where,
                remedy=f"Check that {sys.executable} can be run, and that memory and files are left.",
            ) from error
        ours_if_it_fails.pop_all()
    return Spawned(process, ours, errors)


def _start(
    module: str, arguments: Sequence[str], peer: int, output: int
) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        (sys.executable, "-m", module, str(peer), *arguments),
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=output,
        pass_fds=(peer,),
        # It finds its modules where this process does, however its path was made.
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,
    )


class ChildProcess:
    """The driver's side. `send` may be called from any thread, all else belongs to one.

    Args:
        module: that ``python -m`` runs, which ends in `Parent`.
        where: the device, for messages.
    """

    def __init__(self, module: str, where: str) -> None:
        self._module = module
        self._where = where
        self._process: subprocess.Popen[bytes] | None = None
        self._peer: socket.socket | None = None
        self._errors = -1
        self._words: deque[str] = deque(maxlen=_LAST_WORDS)
        self._begun = b""
        self.starts = 0

    @property
    def pid(self) -> int:
        """Its process id; 0 if there is none."""
        return 0 if self._process is None else self._process.pid

    def start(self) -> None:
        """Start it, in place of one that runs still.

        Raises:
            ConnectionFailed: the system refuses.
        """
        self.kill()
        self._words.clear()
        self._begun = b""
        self._process, self._peer, self._errors = spawn(
            self._module, called="its process", where=self._where
        )
        self.starts += 1

    def send(self, message: bytes) -> None:
        """Send a message.

        Raises:
            ConnectionLost: there is no process, or it takes none.
        """
        peer = self._peer
        if peer is None:
            raise ConnectionLost("its process has ended", where=self._where)
        try:
            peer.send(message)
        except BlockingIOError as error:
            raise ConnectionLost("its process hangs", where=self._where) from error
        except OSError as error:
            raise ConnectionLost("its process has ended", where=self._where) from error

    def receive(self, deadline: float) -> list[bytes]:
        """Return the messages that have come; wait for one until the monotonic `deadline`.

        Raises:
            ConnectionLost: the process has ended, with how and its last words.
        """
        if self._peer is None:
            raise self._ended()
        found: list[bytes] = []
        self._hear_words()
        if not is_readable(self._peer.fileno(), deadline - time.monotonic()):
            return found
        while True:
            try:
                data = self._peer.recv(LONGEST)
            except BlockingIOError:
                return found
            except OSError:
                data = b""
            if not data:
                if found:
                    return found
                raise self._ended()
            found.append(data)

    def kill(self) -> None:
        """End it at once. May be called twice."""
        if self._process is not None:
            self._process.kill()
        self.close(_DIES)

    def close(self, timeout: float) -> None:
        """Let it end by itself, and kill it when it has not within so many seconds. May be called twice."""
        if self._peer is not None:
            self._peer.close()
            self._peer = None
        process, self._process = self._process, None
        if process is not None:
            try:
                process.wait(timeout)
            except subprocess.TimeoutExpired:
                process.kill()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(
                        _DIES
                    )  # longer only where the system is in a driver of its own with it
        if self._errors >= 0:
            os.close(self._errors)
            self._errors = -1

    def _ended(self) -> ConnectionLost:
        how, words = "has ended", self._last_words()
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = self._process.wait(_TELLS_HOW)
                how = f"was ended by signal {-code}" if code < 0 else f"ended with status {code}"
        return ConnectionLost(
            f"its process {how}{words}",
            where=self._where,
            remedy="It is started again by itself.",
        )

    def _last_words(self) -> str:
        """Return what it wrote last, to be put behind a message."""
        self._hear_words()
        return f"; last words: {self._words[-1]}" if self._words else ""

    def _hear_words(self) -> None:
        """Take what it has written: the pipe holds what comes first, not last."""
        with contextlib.suppress(OSError):
            for _ in range(_PIPES):
                if not (data := os.read(self._errors, LONGEST)):
                    break
                *lines, begun = (self._begun + data).split(b"\n")
                self._begun = begun[-LONGEST:]
                told = (line[-LONGEST:].decode(errors="replace") for line in lines)
                self._words.extend(filter(None, told))


class Parent:
    """The child's side.

    Args:
        fd: of the socket, as it was told in the command line.
    """

    def __init__(self, fd: int) -> None:
        # Terminal and service manager signal all: the driver decides what happens.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        faulthandler.enable()
        self._peer = socket.socket(fileno=fd)
        self._peer.setblocking(False)

    def send(self, message: bytes) -> bool:
        """Send a message, and return whether there was room for it: a driver that does not read misses it."""
        try:
            self._peer.send(message)
        except OSError:
            return False
        return True

    def receive(self, wait: float = 0.0) -> list[bytes] | None:
        """Return the messages that have come, after waiting so long for one; None: the driver has ended."""
        found: list[bytes] = []
        if wait > 0.0:
            is_readable(self._peer.fileno(), wait)
        while True:
            try:
                data = self._peer.recv(LONGEST)
            except BlockingIOError:
                return found
            except OSError:
                return None
            if not data:
                return None
            found.append(data)
