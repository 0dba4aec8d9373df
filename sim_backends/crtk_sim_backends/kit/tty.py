"""The serial port of a simulated bus: a pseudo-terminal behind a symbolic link whose path stays the same."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
import termios
import tty
from pathlib import Path
from typing import Final

from crtk_sim_backends.kit.openings import Openings
from crtk_sim_backends.process import SimStartError

_READ_SIZE: Final = 65536
_TCGETS2: Final = 0x802C542A  # Linux, with the speed as a number, any of them
_TERMIOS2: Final = struct.Struct("4I20sII")


class Tty:
    """One pseudo-terminal, opened and closed like an adapter that is plugged in and out.

    Args:
        link: path of the symbolic link by which clients find it.

    Raises:
        SimStartError: from `plug`, when the link cannot be made.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.name = ""
        self._master = -1
        self._slave = -1
        self.openings: Openings | None = None

    @property
    def plugged(self) -> bool:
        """Whether there is a port at present."""
        return self._master >= 0

    def fileno(self) -> int:
        """File descriptor for `select`; -1 while unplugged."""
        return self._master

    def plug(self) -> None:
        """Make a new pseudo-terminal and let the link point to it."""
        if self.link.is_symlink() and not self.link.exists():
            self.link.unlink()  # of a simulator that was killed
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        tty.setraw(self._slave)  # held open: the port must not hang up when a client leaves
        self.name = os.ttyname(self._slave)
        self.openings = Openings(self.name)
        try:
            self.link.symlink_to(self.name)
        except OSError as error:
            self._close()
            raise SimStartError(
                f"cannot make the link {self.link} to the tty: {error.strerror}; it may belong to "
                "another simulator, give another path"
            ) from error

    def unplug(self) -> None:
        """Take it away: clients see errors, and the link is gone. Safe to repeat."""
        if self.plugged:
            self.link.unlink(missing_ok=True)
            self._close()

    def _close(self) -> None:
        if self.openings is not None:
            self.openings.close()
            self.openings = None
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1

    def look(self) -> bool:
        """Return whether the last client has left: nothing that was sent to it is left, as at a real port."""
        has_left = self.openings is not None and self.openings.look()
        if has_left and not self.clients:
            fcntl.ioctl(self._slave, termios.TIOCNXCL)
            termios.tcflush(self._slave, termios.TCIFLUSH)
        return has_left

    @property
    def clients(self) -> int:
        """How many have it open."""
        return 0 if self.openings is None else self.openings.count

    @property
    def baud(self) -> int:
        """Bits a second that the client has set."""
        answer = fcntl.ioctl(self._master, _TCGETS2, bytes(_TERMIOS2.size))
        return int(_TERMIOS2.unpack(answer)[-1])

    def read(self) -> bytes:
        """What the client has sent; nothing if there is nothing."""
        try:
            return os.read(self._master, _READ_SIZE)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError as error:
            if error.errno == errno.EIO:
                return b""
            raise

    def write(self, data: bytes) -> int:
        """Send to the client: how many bytes its buffer has taken."""
        with contextlib.suppress(BlockingIOError, InterruptedError):
            return os.write(self._master, data)
        return 0
