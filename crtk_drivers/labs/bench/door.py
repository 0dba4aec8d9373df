"""The other side of a host's door: a device under test, as the conductor of a bench has it."""

from __future__ import annotations

import os
import socket
import struct
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Client, Connection, answer_challenge, deliver_challenge
from typing import Any, Final, Self

from crtk_drivers.errors import CrtkError, DeviceError
from crtk_drivers.labs.bench.calls import Failed
from crtk_drivers.samples import Value

ANSWER_TIMEOUT: Final = 2.0
"""Seconds for an answer, beside what the call itself may take."""


def bound_waits(connection: Connection, seconds: float) -> None:
    """Let reading or writing a part of a message end with `BlockingIOError` when it takes so long."""
    whole, rest = divmod(seconds, 1.0)
    limit = struct.pack("ll", int(whole), int(1e6 * rest))
    with socket.socket(fileno=os.dup(connection.fileno())) as each:
        for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
            each.setsockopt(socket.SOL_SOCKET, option, limit)


class DoorClosed(DeviceError):
    """The process of the device is gone, or does not answer."""


class Refused(CrtkError):
    """The device did not do what it was asked to; `reason` as in a refusal, empty otherwise."""

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(text)
        self.reason = reason


class Door:
    """One connection. Thread-safe: calls wait for each other.

    Args:
        path, key: of the door.
        timeout: seconds in which it must be there.
        gone: why it will never be there; empty as long as it may.

    Raises:
        DoorClosed: it is not.
    """

    def __init__(
        self, path: str, key: bytes, timeout: float, gone: Callable[[], str] = lambda: ""
    ) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._asked = 0
        self._connection = self._connected(key, timeout, gone)

    def close(self) -> None:
        """Leave; commands of this connection end. May be called twice."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def call(self, name: str, *arguments: Any, within: float = 0.0) -> Any:
        """Ask for something and return the answer.

        Args:
            name: of the call, see `crtk_drivers.labs.bench.host`.
            arguments: of it.
            within: seconds that it may take.

        Raises:
            Refused: with what the device says.
            DoorClosed: no answer in time.
        """
        with self._lock:
            try:
                answer = self._answer(name, arguments, time.monotonic() + within + ANSWER_TIMEOUT)
            except TimeoutError:
                self._connection.close()
                raise DoorClosed(f"{name}: no answer in {within + ANSWER_TIMEOUT:g} s") from None
            except (EOFError, OSError) as error:
                raise DoorClosed(f"{name}: the driver's process is gone") from error
        if isinstance(answer, Failed):
            raise Refused(answer.text, answer.reason)
        return answer

    def submit(self, name: str, value: Value | None = None, stamp_ns: int = 0) -> None:
        """Send a CRTK command.

        Raises:
            Refused, DoorClosed: as `call`.
        """
        self.call("submit", name, value, stamp_ns)

    def _answer(self, name: str, arguments: tuple[Any, ...], deadline: float) -> Any:
        """Ask, and return the answer to this question: one that Ctrl-C broke off left its own behind."""
        self._asked += 1
        self._connection.send((self._asked, name, *arguments))
        while self._connection.poll(max(0.0, deadline - time.monotonic())):
            try:
                number, answer = self._connection.recv()
            except (EOFError, OSError):
                raise
            except Exception as error:  # Ctrl-C came within an answer: what follows is none
                self._connection.close()
                raise DoorClosed(f"{name}: what is answered cannot be read") from error
            if number == self._asked:
                return answer
        raise TimeoutError

    def _connected(self, key: bytes, timeout: float, gone: Callable[[], str]) -> Connection:
        deadline = time.monotonic() + timeout
        while True:
            try:
                connection = Client(self._path, "AF_UNIX")
            except (FileNotFoundError, ConnectionRefusedError) as error:
                if why := gone():
                    raise DoorClosed(why) from error
                if time.monotonic() > deadline:
                    raise DoorClosed(
                        f"the driver's process does not answer within {timeout:g} s"
                    ) from error
                time.sleep(0.02)
            else:
                return _authenticated(connection, key, timeout)


def _authenticated(connection: Connection, key: bytes, timeout: float) -> Connection:
    """Return a connection of which both sides know the key; the other one may stand still.

    Raises:
        DoorClosed: it does not answer in time, or is gone.
    """
    bound_waits(connection, timeout)
    try:
        answer_challenge(connection, key)
        deliver_challenge(connection, key)
    except (EOFError, OSError) as error:
        connection.close()
        raise DoorClosed(f"the driver's process does not answer within {timeout:g} s") from error
    bound_waits(connection, ANSWER_TIMEOUT)
    return connection
