"""The ways to input devices: a file of the kernel, or a socket in the file system."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import time
from abc import ABC, abstractmethod
from typing import Final

from typing_extensions import override

from crtk_driver_inputs import events, spacenav
from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit.readable_files import is_readable

__all__ = ["FileWay", "SocketWay", "Way"]

_CHUNK: Final = 4096
_ANSWER: Final = 0.3
"""Seconds in which a daemon answers which protocol it speaks (libspnav waits as long)."""
_REMEDIES: Final = {
    errno.ENOENT: "Is it plugged in, and is this its name? See ls /dev/input/by-id.",
    errno.EACCES: "Join the group input (sudo usermod -aG input $USER), and log in again.",
    errno.EPERM: "Join the group input (sudo usermod -aG input $USER), and log in again.",
    errno.EBUSY: "Another program has grabbed it.",
    errno.ECONNREFUSED: "Does spacenavd run? See systemctl status spacenavd.",
}


class Way(ABC):
    """Bytes of one device; see `crtk_drivers.kit.Transport`, of which this has what is needed.

    Args:
        path: in the file system.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._fd = -1

    @property
    def where(self) -> str:
        """For messages."""
        return f"inputs {self.path}"

    @abstractmethod
    def open(self, deadline: float) -> bytes:
        """Open it, and return what it has told meanwhile.

        Raises:
            ConnectionFailed: it cannot be opened.
        """

    @abstractmethod
    def close(self) -> None:
        """Close it. May be called twice."""

    @property
    @abstractmethod
    def answers(self) -> bool:
        """Whether it answers what `ask` asks, as long as it is alive."""

    @abstractmethod
    def ask(self) -> None:
        """Ask whether it is alive.

        Raises:
            ConnectionLost: it has ended.
        """

    def read(self) -> bytes:
        """Return what has come; nothing if nothing has. It does not wait.

        Raises:
            ConnectionLost: it was unplugged, or the daemon has ended.
        """
        try:
            if not is_readable(self._fd, 0.0):
                return b""
            data = os.read(self._fd, _CHUNK)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise self._gone(str(error)) from error
        if not data:
            raise self._gone("it has ended")
        return data

    def _gone(self, why: str) -> ConnectionLost:
        return ConnectionLost(
            f"it is gone: {why}",
            where=self.where,
            remedy="Plug it in again: it is found by its name.",
        )

    def _failed(self, error: OSError) -> ConnectionFailed:
        why = error.strerror or str(error)
        remedy = _REMEDIES.get(error.errno or 0, "Is it the right device?")
        return ConnectionFailed(f"it cannot be opened: {why}", where=self.where, remedy=remedy)


class FileWay(Way):
    """A device of the kernel.

    Args:
        path: of it.
        grab: let nobody else have its events.
    """

    def __init__(self, path: str, *, grab: bool = False) -> None:
        super().__init__(path)
        self._grab = grab

    @override
    def open(self, deadline: float) -> bytes:
        self.close()
        try:
            self._fd = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
            if self._grab:
                fcntl.ioctl(self._fd, events.GRAB, 1)
        except OSError as error:
            self.close()
            raise self._failed(error) from error
        return b""

    def pressed(self) -> frozenset[int]:
        """Return which keys are pressed now; none of a device that cannot tell."""
        state = bytearray(events.KEYS)
        try:
            fcntl.ioctl(self._fd, events.get_keys_request(), state)
        except OSError:
            return frozenset()
        return events.pressed_keys(bytes(state))

    @property
    @override
    def answers(self) -> bool:
        return False

    @override
    def ask(self) -> None:
        """The kernel tells by itself that a device is gone."""

    @override
    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class SocketWay(Way):
    """The socket of spacenavd."""

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self._socket: socket.socket | None = None
        self.version = 0

    @override
    def open(self, deadline: float) -> bytes:
        self.close()
        self._socket = opened = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        opened.settimeout(max(0.01, deadline - time.monotonic()))
        try:
            opened.connect(self.path)
            opened.sendall(spacenav.HELLO)
            told = self._answer(opened, min(deadline, time.monotonic() + _ANSWER))
            self.version, rest = spacenav.agreed(told) or (0, told)
            opened.sendall(spacenav.ASK_FOR_MOUSE if self.version else spacenav.SENSITIVITY)
        except OSError as error:
            self.close()
            raise self._failed(error) from error
        opened.settimeout(0.0)
        self._fd = opened.fileno()
        return rest

    @property
    @override
    def answers(self) -> bool:
        return self.version > 0  # one of protocol 0 cannot be asked

    @override
    def ask(self) -> None:
        if self._socket is None or not self.answers:
            return
        try:
            self._socket.send(spacenav.ASK_FOR_MOUSE)
        except BlockingIOError:
            return  # it reads nothing, and so will answer nothing
        except OSError as error:
            raise self._gone(str(error)) from error

    @staticmethod
    def _answer(opened: socket.socket, end: float) -> bytes:
        """Return what it tells until it has agreed to a protocol, or does not until `end`."""
        told = b""
        while spacenav.agreed(told) is None and len(told) < _CHUNK:
            left = end - time.monotonic()
            if left <= 0.0:
                break
            opened.settimeout(left)
            try:
                data = opened.recv(_CHUNK)
            except TimeoutError:
                break
            if not data:
                break
            told += data
        return told

    @override
    def close(self) -> None:
        self._fd = -1
        if self._socket is not None:
            self._socket.close()
            self._socket = None
