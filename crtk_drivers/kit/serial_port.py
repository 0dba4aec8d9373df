"""A serial port: opened exclusively, read with deadlines, found again when it was unplugged.

pyserial opens and configures it, or it is the connection to a server (``socket://host:port``). Reading and
writing are poll, read and write, so that waiting costs no CPU.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import math
import os
import select
import socket
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, Self

from crtk_drivers.device.giving_up import GIVEN_UP
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, DeviceError, MissingExtra
from crtk_drivers.kit import latency
from crtk_drivers.kit.adapters import BY_ID
from crtk_drivers.kit.holders import holders, lock_owner
from crtk_drivers.kit.latency import Latency
from crtk_drivers.kit.ready import is_ready
from crtk_drivers.kit.serial_server import OPEN_TIMEOUT, ServerAddress, connect, parse_address

try:
    import serial
except ImportError as error:
    raise MissingExtra("pyserial", "serial") from error

__all__ = ["BITS_PER_BYTE", "SerialPort", "stable_name"]

BITS_PER_BYTE: Final = 10
"""On the wire: a start bit, eight of data, a stop bit."""

_PTY_MAJORS: Final = range(136, 144)
_WRITE_PATIENCE: Final = 0.5
_CHUNK: Final = 4096


def stable_name(device: Path, by_id: Path = BY_ID) -> Path | None:
    """Return the name of a port that stays when the adapter is plugged in again, None if it has none."""
    target = device.resolve()
    try:
        links = sorted(by_id.iterdir())
    except OSError:
        return None
    return next((link for link in links if link.resolve() == target), None)


class SerialPort:
    """One serial port. It belongs to the thread that runs the bus; others may `write_from_outside`.

    Args:
        name: device file or a link to it, for example under /dev/serial/by-id; or ``socket://host:port``.
        baud: in bit/s; any that the adapter can do. That of a server is its own: this one must be the same.
        parity: "none", "even" or "odd"; of a device file that is no pseudo-terminal, which has none.
        data_bits: of a byte, 7 or 8; of a pseudo-terminal always 8.
        clock: monotonic seconds.
        by_id: where the stable names of ports are.

    Attributes:
        latency: the adapter's latency timer, known once it is open.

    Raises:
        ValueError: the name is a URL, and none of a server.
    """

    def __init__(
        self,
        name: str | Path,
        baud: int = 1_000_000,
        *,
        parity: str = "none",
        data_bits: int = 8,
        clock: Callable[[], float] = time.monotonic,
        by_id: Path = BY_ID,
    ) -> None:
        self.name = str(name)
        self.latency = Latency(None)
        self._server = parse_address(self.name)
        self._baud = baud
        self._parity = parity[0].upper()  # as pyserial names them
        self._data_bits = data_bits
        self._clock = clock
        self._by_id = by_id
        self._stable: Path | None = None
        self._opened_as: serial.Serial | socket.socket | None = None
        self._fd = -1
        self._poll = select.poll()
        self._writing = threading.Lock()

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def where(self) -> str:
        """The port and its rate, for messages."""
        return f"port {self.name} at {self._baud} bit/s"

    @property
    def baud(self) -> int:
        """Rate in bit/s."""
        return self._baud

    @property
    def is_open(self) -> bool:
        """Whether it is open; an unplugged one is until `close`."""
        return self._opened_as is not None

    def fileno(self) -> int:
        """Return the file descriptor, for a selector; -1 while it is closed."""
        return self._fd

    @property
    def has_own_rate(self) -> bool:
        """Whether its rate is set by a server, and not here."""
        return self._server is not None

    def open(self, deadline: float = math.inf) -> None:
        """Open the port, or open it anew; found by its stable name if it has been open before.

        A server is waited for until the monotonic `deadline`, and for `OPEN_TIMEOUT` seconds at most.

        Raises:
            ConnectionFailed: it is not there, is in use, or does not take the rate.
        """
        self.close()
        if self._server is not None:
            self._open_server(self._server, min(OPEN_TIMEOUT, deadline - self._clock()))
        else:
            self._open_device()
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def _open_server(self, server: ServerAddress, timeout: float) -> None:
        try:
            opened = connect(server, max(0.001, timeout))
        except OSError as error:
            raise ConnectionFailed(
                f"the server cannot be reached: {error.strerror or error}",
                where=self.where,
                remedy="Check that it runs, its address, and that no other program is connected to it.",
            ) from error
        self._opened_as, self._fd = opened, opened.fileno()

    def _open_device(self) -> None:
        path = self._path()
        try:
            device = path.resolve(strict=True)
        except OSError as error:
            raise self._not_there() from error
        is_pty = self._is_pty(device)
        if not is_pty and (others := holders(device)):
            raise self._in_use(", ".join(map(str, others)))
        try:
            parity, bits = (serial.PARITY_NONE, 8) if is_pty else (self._parity, self._data_bits)
            opened = serial.Serial(str(device), self._baud, bits, parity, timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            raise self._not_opened(device, error) from error
        self._opened_as = opened
        self._fd = opened.fileno()
        try:
            self._configure(is_pty=is_pty)
        except (OSError, termios.error) as error:
            self.close()
            raise self._not_opened(device, error) from error
        self._stable = stable_name(device, self._by_id)
        self.latency = latency.lower(device, lambda: opened.set_low_latency_mode(True))

    def close(self) -> None:
        """Close it. May be called twice, and after it was unplugged."""
        opened, self._opened_as, self._fd = self._opened_as, None, -1
        if opened is not None:
            with contextlib.suppress(OSError, termios.error):
                opened.close()

    def set_baud(self, baud: int) -> None:
        """Change the rate.

        Raises:
            DeviceError: the adapter does not take it, or it is a server's; the rate is then as before.
        """
        opened = self._opened()
        if isinstance(opened, socket.socket):
            if baud != self._baud:
                raise DeviceError(
                    f"{baud} bit/s refused: the rate is set at the server",
                    where=self.where,
                    remedy="Set it there, and give the same one as baud.",
                )
            return
        before = self._baud
        try:
            opened.baudrate = baud
            self._block()
        except (OSError, ValueError, termios.error) as error:
            with contextlib.suppress(OSError, ValueError, termios.error):
                opened.baudrate = before
                self._block()
            raise DeviceError(
                f"{baud} bit/s refused: {error}",
                where=self.where,
                remedy="Take a rate that the adapter knows.",
            ) from error
        self._baud = baud

    def send_break(self, seconds: float) -> None:
        """Hold the line at zero for so long; waits for it.

        What hears it takes it for a byte of zeros without a stop bit. A pseudo-terminal carries no break, and
        is written that byte.

        Raises:
            ConnectionLost: it is gone.
            DeviceError: it is a server's, which has no way to say so.
        """
        opened = self._opened()
        if isinstance(opened, socket.socket):
            raise DeviceError(
                "a break cannot be sent through a server",
                where=self.where,
                remedy="Send it there, or connect the line to this computer.",
            )
        try:
            if self._is_pty(Path(opened.name)):
                os.write(self._fd, b"\0")
            opened.break_condition = True
            time.sleep(seconds)
            opened.break_condition = False
        except OSError as error:
            raise self._lost(error) from error

    def wire_time(self, size: int) -> float:
        """Return the seconds that so many bytes take on the wire."""
        return size * BITS_PER_BYTE / self._baud

    def write(self, data: bytes) -> None:
        """Hand bytes to the adapter.

        Raises:
            ConnectionLost: it is gone, or takes no bytes.
        """
        try:
            with self._writing:
                sent = os.write(self._fd, data)
            if sent < len(data):
                self._write_rest(data[sent:])
        except BlockingIOError:
            self._write_rest(data)
        except OSError as error:
            raise self._lost(error) from error

    def write_from_outside(self, data: bytes, patience: float) -> bool:
        """Hand bytes to the adapter from another thread than the one that the port belongs to.

        Args:
            data: a whole packet, or several.
            patience: seconds to wait for a write of that thread; then they are handed over all the same.

        Returns:
            whether the adapter took all of them.
        """
        locked = self._writing.acquire(timeout=patience)
        try:
            return os.write(self._fd, data) == len(data)
        except (OSError, ValueError):
            return False
        finally:
            if locked:
                self._writing.release()

    def read(self, deadline: float) -> bytes:
        """Return what has arrived as soon as there is any; nothing if none came before the deadline.

        What arrived while this process was kept from looking is returned even when the deadline is past.
        The wait ends up to 1 ms after the deadline.

        Raises:
            ConnectionLost: it is gone, or `Device.open` waits and the program ends.
        """
        try:
            is_ready(self._poll, deadline, self._clock)
            data = os.read(self._fd, _CHUNK)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost(OSError(errno.EIO, "hung up"))
        return data

    def drain(self) -> bytes:
        """Return what has arrived by now, without waiting.

        Raises:
            ConnectionLost: it is gone.
        """
        return self.read(0.0) if self._poll.poll(0) else b""

    def _write_rest(self, data: bytes) -> None:
        deadline = self._clock() + _WRITE_PATIENCE + self.wire_time(len(data))
        ready = select.poll()
        ready.register(self._fd, select.POLLOUT)
        while data:
            left = deadline - self._clock()
            if left <= 0.0 or not ready.poll(math.ceil(left * 1000.0)):
                raise self._lost(OSError(errno.ETIMEDOUT, "it takes no bytes"))
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._fd, data) :]

    def _path(self) -> Path:
        """Return the name to open: the stable one if the given one may mean another adapter by now."""
        return self._stable or Path(self.name)

    @staticmethod
    def _is_pty(device: Path) -> bool:
        return os.major(os.stat(device).st_rdev) in _PTY_MAJORS

    def _configure(self, *, is_pty: bool) -> None:
        self._block()
        # A pseudo terminal keeps the mark when its user dies, and nobody could open it again.
        if not is_pty:
            fcntl.ioctl(self._fd, termios.TIOCEXCL)

    def _block(self) -> None:
        """Have an empty read told from a hang-up: pyserial sets VMIN to 0, where both return nothing."""
        attributes = termios.tcgetattr(self._fd)
        attributes[6][termios.VMIN] = 1
        attributes[6][termios.VTIME] = 0
        termios.tcsetattr(self._fd, termios.TCSANOW, attributes)

    def _opened(self) -> serial.Serial | socket.socket:
        if self._opened_as is None:
            raise ConnectionLost("the port is closed", where=self.where, remedy="Open it.")
        return self._opened_as

    def _not_there(self) -> ConnectionFailed:
        try:
            known = ", ".join(str(link) for link in sorted(self._by_id.iterdir()))
        except OSError:
            known = ""
        listed = f" Ports there are: {known}." if known else " No USB serial adapter is plugged in."
        return ConnectionFailed(
            "there is no such port",
            where=self.where,
            remedy=f"Plug the adapter in, and check the name.{listed}",
        )

    def _in_use(self, who: str) -> ConnectionFailed:
        return ConnectionFailed(
            f"the port is in use by {who}",
            where=self.where,
            remedy="End that program, or give this one another port: one bus has one master.",
        )

    def _not_opened(self, device: Path, error: Exception) -> ConnectionFailed:
        code = getattr(error, "errno", None)
        if code in (errno.EBUSY, errno.EAGAIN):
            owner = lock_owner(device)
            others = [owner] if owner else holders(device)
            return self._in_use(", ".join(map(str, others)) or "another user's process")
        if code in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
            return self._not_there()
        if code in (errno.EACCES, errno.EPERM):
            return ConnectionFailed(
                "the port may not be opened by this user",
                where=self.where,
                remedy="Add yourself to its group, mostly: sudo usermod -aG dialout $USER; log in again.",
            )
        return ConnectionFailed(
            f"the port cannot be opened: {error}",
            where=self.where,
            remedy="Check that it is a serial port, and that the adapter takes this rate.",
        )

    def _lost(self, error: Exception) -> ConnectionLost:
        if self._opened_as is None:
            return ConnectionLost("the port is closed", where=self.where, remedy="Open it.")
        if getattr(error, "errno", None) == errno.ECANCELED:
            return ConnectionLost(GIVEN_UP, where=self.where)
        if self._server is not None:
            return ConnectionLost(
                f"the connection is gone: {error}",
                where=self.where,
                remedy="Check the network and the server; it is connected again when that answers.",
            )
        return ConnectionLost(
            f"the adapter is gone: {error}",
            where=self.where,
            remedy="Check the USB cable and the adapter; it is found again when it is plugged in.",
        )
