"""What is attached to the tool of a simulated controller: a tty, or a stream socket to which it connects."""

from __future__ import annotations

import contextlib
import logging
import re
import socket
import termios
from collections.abc import Callable
from typing import Any, Final, Protocol

from crtk_sim_backends.options import ConfigError
from crtk_sim_backends.process import SimStartError
from crtk_sim_backends.ur.signals.tool_line import LineSettings

CONNECT_TIMEOUT: Final = 2.0  # s, at the start
RETRY_PERIOD: Final = 1.0  # s, after the device was lost
_READ_SIZE: Final = 4096
_PARITY_LETTERS: Final = "NOE"  # of pyserial, in the order of the manual

log = logging.getLogger(__name__)


class Stream(Protocol):
    """An open connection to the device. Nothing waits; OSError tells that the device is gone."""

    def read(self) -> bytes:
        """What has come since the last call."""

    def write(self, data: bytes) -> None:
        """Send; a device that does not take it in loses it, as there is no flow control."""

    def configure(self, settings: LineSettings) -> None:
        """Set rate, parity and stop bits, where there are such."""

    def close(self) -> None:
        """Let go of it."""


class _TtyStream:
    """A tty or pseudo-terminal, by pyserial."""

    def __init__(self, path: str) -> None:
        import serial

        # SerialException is an OSError.
        self._port: Any = serial.Serial(path, timeout=0, write_timeout=0, exclusive=True)

    def read(self) -> bytes:
        return bytes(self._port.read(_READ_SIZE))

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def configure(self, settings: LineSettings) -> None:
        self._port.baudrate = settings.baud
        try:
            self._port.parity = _PARITY_LETTERS[settings.parity]
        except termios.error:  # a pseudo-terminal has none
            self._port.parity = _PARITY_LETTERS[0]
        self._port.stopbits = settings.stop_bits

    def close(self) -> None:
        self._port.close()


class _SocketStream:
    """A TCP or Unix stream socket. With `timeout` 0 it connects while it is read."""

    def __init__(self, family: int, address: Any, timeout: float) -> None:
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._socket.settimeout(timeout)
            with contextlib.suppress(BlockingIOError):
                self._socket.connect(address)
            self._socket.setblocking(False)
            if family == socket.AF_INET:
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError:
            self._socket.close()
            raise

    def read(self) -> bytes:
        try:
            data = self._socket.recv(_READ_SIZE)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionResetError("it closed the connection")
        return data

    def write(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):
            self._socket.send(data)

    def configure(self, settings: LineSettings) -> None:
        pass

    def close(self) -> None:
        self._socket.close()


def parse_device(address: str) -> Callable[[float], Stream]:
    """Return what connects to a device, given a timeout.

    Args:
        address: ``tcp://host:port``, ``unix:///path``, or the path of a tty.

    Raises:
        ConfigError: it is none of these.
    """
    if address.startswith("/"):
        return lambda timeout: _TtyStream(address)
    if match := re.fullmatch(r"unix://(/.+)", address):
        path = match[1]
        return lambda timeout: _SocketStream(socket.AF_UNIX, path, timeout)
    if match := re.fullmatch(r"tcp://([^/:]+):(\d{1,5})", address):
        host, port = match[1], int(match[2])
        return lambda timeout: _SocketStream(socket.AF_INET, (host, port), timeout)
    raise ConfigError(
        "tool_device must be tcp://host:port, unix:///path or the absolute path of a tty, "
        f"not {address!r}"
    )


class ToolDevice:
    """The device; after a loss it is connected to again. Times are those of the controller, s.

    Args:
        address: as for :func:`parse_device`.

    Raises:
        SimStartError: nobody is there.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._connect = parse_device(address)
        self._settings = LineSettings()
        self._retry_time = 0.0
        self._stream: Stream | None = None
        try:
            self._stream = self._connect(CONNECT_TIMEOUT)
        except ImportError as error:
            raise SimStartError(
                "tool_device: a tty needs pyserial; install it with "
                "`pip install 'crtk-drivers[ur-sim]'`"
            ) from error
        except OSError as error:
            raise SimStartError(
                f"tool_device: cannot connect to {address}: {error}; start the device first"
            ) from error

    def configure(self, settings: LineSettings) -> None:
        """Set rate, parity and stop bits, where there are such."""
        self._settings = settings
        if self._stream is not None:
            self._stream.configure(settings)

    def read(self, now: float) -> bytes:
        """What has come since the last call."""
        try:
            if self._stream is None:
                if now < self._retry_time:
                    return b""
                self._stream = self._connect(0.0)
                self._stream.configure(self._settings)
            return self._stream.read()
        except OSError as error:
            self._lose(error, now)
            return b""

    def write(self, data: bytes) -> None:
        """Send to the device; while it is gone, nobody hears it."""
        if self._stream is None or not data:
            return
        try:
            self._stream.write(data)
        except OSError as error:
            self._lose(error, 0.0)

    def _lose(self, error: OSError, now: float) -> None:
        if self._stream is not None:
            log.warning("the device at the tool, %s, is gone: %s", self._address, error)
        self.close()
        self._retry_time = now + RETRY_PERIOD

    def close(self) -> None:
        """Let go of it."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None
