"""Counts the clients of a tty, by the openings and closings that the system tells (Linux, inotify).

The system tells several openings, or closings, in a row as one. So when somebody closes the tty, those who
have it open are looked up in /proc: it shows the processes of the same user, who alone may open a tty.
"""

from __future__ import annotations

import ctypes
import glob
import os
import struct
from typing import Final

from crtk_sim_backends.process import SimStartError

_OPENED: Final = 0x20  # IN_OPEN
_CLOSED: Final = 0x18  # IN_CLOSE_WRITE | IN_CLOSE_NOWRITE
_EVENT: Final = struct.Struct("iIII")


class Openings:
    """Watches one file.

    Args:
        path: of the file; who has it open already is none of the clients.

    Attributes:
        count: of the clients.

    Raises:
        SimStartError: from the constructor, when the system allows no more watches.
    """

    def __init__(self, path: str) -> None:
        self.count = 0
        self._path = path
        self._others = _descriptors(path)
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
        masks = self._told()
        if not any(mask & _CLOSED for mask in masks):
            self.count += len(masks)
            return False
        held = _descriptors(self._path) - self._others
        while more := self._told():  # meanwhile, so that `held` may be old
            masks += more
            held = _descriptors(self._path) - self._others
        count, was_empty, came_after = self.count, False, False
        for mask in masks:
            count += 1 if mask & _OPENED else -1
            if count <= 0:
                count, was_empty, came_after = 0, True, False
            else:
                came_after = was_empty
        self.count = max(held, int(came_after))
        return held <= 0 or came_after

    def _told(self) -> list[int]:
        """Return what has been told since the last call: the masks of openings and closings, in order."""
        try:
            data = os.read(self._fd, 65536)
        except BlockingIOError:
            return []
        masks, at = [], 0
        while at < len(data):
            _, mask, _, name = _EVENT.unpack_from(data, at)
            if mask & (_OPENED | _CLOSED):
                masks.append(mask)
            at += _EVENT.size + name
        return masks

    def close(self) -> None:
        """Stop watching."""
        os.close(self._fd)


def _descriptors(path: str) -> int:
    """Return how many file descriptors of this user's processes are of a file."""
    wanted, found = os.stat(path), 0
    for each in glob.iglob("/proc/[0-9]*/fd/*"):
        try:  # its name alone could be that of another container's file
            found += os.readlink(each) == path and os.path.samestat(os.stat(each), wanted)
        except OSError:
            continue  # closed meanwhile
    return found


def _error(path: str) -> SimStartError:
    reason = os.strerror(ctypes.get_errno())
    return SimStartError(
        f"cannot watch {path} for clients: {reason}; see /proc/sys/fs/inotify/max_user_instances"
    )
