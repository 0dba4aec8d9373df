"""Counts the clients of a tty, by the openings and closings that the system tells (Linux, inotify)."""

from __future__ import annotations

import ctypes
import os
import struct
from typing import Final

from crtk_sim_backends.process import SimStartError

_OPENED: Final = 0x20  # IN_OPEN
_CLOSED: Final = 0x18  # IN_CLOSE_WRITE | IN_CLOSE_NOWRITE
_EVENT: Final = struct.Struct("iIII")


class Openings:
    """Watches one file.

    Raises:
        SimStartError: from the constructor, when the system allows no more watches.
    """

    def __init__(self, path: str) -> None:
        self.count = 0
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._fd: int = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if self._fd < 0:
            raise _error(path)
        if self._libc.inotify_add_watch(self._fd, path.encode(), _OPENED | _CLOSED) < 0:
            error = _error(path)
            os.close(self._fd)
            raise error

    def fileno(self) -> int:
        """File descriptor for `select`."""
        return self._fd

    def look(self) -> bool:
        """Take what has happened; whether the last client has left, even if another one has come since."""
        has_left = False
        try:
            data = os.read(self._fd, 65536)
        except BlockingIOError:
            return False
        at = 0
        while at < len(data):
            _, mask, _, name = _EVENT.unpack_from(data, at)
            self.count += bool(mask & _OPENED) - bool(mask & _CLOSED)
            has_left = has_left or self.count == 0
            at += _EVENT.size + name
        return has_left

    def close(self) -> None:
        """Stop watching."""
        os.close(self._fd)


def _error(path: str) -> SimStartError:
    reason = os.strerror(ctypes.get_errno())
    return SimStartError(
        f"cannot watch {path} for clients: {reason}; see /proc/sys/fs/inotify/max_user_instances"
    )
