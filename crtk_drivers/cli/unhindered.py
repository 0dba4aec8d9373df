"""A stream that holds nobody up: what cannot be written at once is left out, and counted.

A terminal that was stopped (Ctrl-S), a pager that is not scrolled, a program that hangs: whoever writes to
them waits, with all threads that want to tell something after him, and the one that talks to a device is
among them.
"""

from __future__ import annotations

import errno
import os
import socket
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

__all__ = ["Unhindered", "open_missing_streams"]


def open_missing_streams() -> None:
    """Let standard streams that whoever started the process has closed lead nowhere.

    Else what is opened next, a device's line or a socket of DDS, gets the number that all write their
    errors to; and rclpy does not start without standard error.
    """
    for descriptor, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(descriptor)
        except OSError:
            # The lowest number that is free, which is this one: those below it are open.
            os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - as long as the process


class Unhindered:
    """Another stream, of which only terminals, pipes and sockets (a journal's) are written to in this way.

    The first two are opened once more for that: whether a write waits is a matter of all who share an opened
    file. A socket is told so with each write.

    Args:
        stream: of text.
    """

    def __init__(self, stream: IO[str]) -> None:
        self.stream = stream
        self._own: int | None = None
        self._opened: tuple[int, ...] | None = None
        self._lost = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def write(self, text: str) -> int:
        """Write what can be written now; what cannot be, as on a disk that is full, is left out.

        Raises:
            BrokenPipeError: nobody reads it any more, or its terminal is gone.
        """
        with self._without_failing(text), _gone_is_broken():
            self._write(text)
        return len(text)

    def flush(self) -> None:
        """Write what the stream itself has kept. Raises as `write` does."""
        with self._without_failing(""), _gone_is_broken():
            self.stream.flush()

    @contextmanager
    def _without_failing(self, text: str) -> Iterator[None]:
        """Count `text` as left out where it could not be written: who writes has more to do."""
        try:
            yield
        except BrokenPipeError:
            raise
        except (OSError, ValueError):  # there is no room, or it is closed
            self._lost += text.count("\n")

    def _write(self, text: str) -> None:
        own = self._descriptor()
        if own is None:
            self.stream.write(text)
            return
        gap = f"\n{self._lost} lines were left out here: nobody read them.\n" if self._lost else ""
        data = (gap + text).encode(
            getattr(self.stream, "encoding", None) or "utf-8", "backslashreplace"
        )
        try:
            written = _written_now(own, data)
        except BlockingIOError:
            self._lost += text.count("\n")
        else:
            self._lost = data[written:].count(b"\n")

    def close(self) -> None:
        """Close what was opened here; the stream stays open."""
        if self._own is not None:
            os.close(self._own)
        self._own = self._opened = None

    def _descriptor(self) -> int | None:
        """Return one of our own for where the stream goes now; None if it has to be written as ever."""
        try:
            descriptor = self.stream.fileno()
            info = os.fstat(descriptor)
        except (OSError, ValueError):  # it is no file, or is closed
            self.close()
            return None
        place = (info.st_dev, info.st_ino, info.st_rdev)
        if place != self._opened:
            self.close()
            self._opened = place
            if stat.S_ISFIFO(info.st_mode) or os.isatty(descriptor):
                self._own = _opened_again(descriptor)
            elif stat.S_ISSOCK(info.st_mode):
                self._own = os.dup(descriptor)
        return self._own


def _written_now(descriptor: int, data: bytes) -> int:
    if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
        return os.write(descriptor, data)
    shared = socket.socket(fileno=descriptor)
    try:
        return shared.send(data, socket.MSG_DONTWAIT)
    finally:
        shared.detach()


@contextmanager
def _gone_is_broken() -> Iterator[None]:
    """Tell that a terminal is gone as that a pipe is: who has lost it may go on without."""
    try:
        yield
    except OSError as error:
        if error.errno == errno.EIO:
            raise BrokenPipeError(errno.EPIPE, "the terminal is gone") from error
        raise


def _opened_again(descriptor: int) -> int | None:
    flags = os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
    try:
        return os.open(f"/proc/self/fd/{descriptor}", flags)
    except OSError:  # no such system, another user's terminal, or nobody reads it
        return None
