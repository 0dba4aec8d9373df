"""The far side of an RDT stream, for tests that need each datagram to be a chosen one."""

from __future__ import annotations

import errno
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Self

from rigs.waiting import LONG

RECORD = struct.Struct(">III6i")

UPTIME = 1000.0
"""Seconds for which the sensor was on before: it is late by less, so that a restart is seen by its clock."""


def record(rdt: int, ft: int, status: int = 0, counts: tuple[int, ...] = (0,) * 6) -> bytes:
    """Return one record."""
    return RECORD.pack(rdt % 2**32, ft % 2**32, status, *counts)


class Peer:
    """A sensor that does what a test tells it; on a free port of its own.

    Attributes:
        on_start: called with each start request's command, in the peer's thread, or None.
        rate: of the stream of records that it sends from a start to a stop, in Hz; 0 for none.
        tick_rate: of its own measurements, in Hz.
        status, counts: what its records hold.
        drift: counts by which its first axis grows from each record of the stream to the next.
        frozen: its measurements stand still.
        late: seconds for which it goes on as it was after a request.
        requests: all that arrived, as (command, count).
        sent: records of its stream since it was asked for.
    """

    def __init__(self, host: str = "127.0.0.1") -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((host, 0))
        self.socket.settimeout(0.001)
        self.host, self.port = self.socket.getsockname()
        self.requests: list[tuple[int, int]] = []
        self.client: tuple[str, int] | None = None
        self.on_start: Callable[[int], object] | None = None
        self.rate = 0.0
        self.tick_rate = 7000.0
        self.status = 0
        self.counts: tuple[int, ...] = (0,) * 6
        self.drift = 0
        self.frozen = False
        self.late = 0.0
        self._begun = time.monotonic()
        self._booted = self._begun - UPTIME
        self.sent = 0
        self._ticks = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def send(self, *datagrams: bytes) -> None:
        """Send to whoever asked last."""
        assert self.client is not None
        for data in datagrams:
            self.socket.sendto(data, self.client)

    def stream(self, count: int, rdt: int = 1, ft: int = 1000, step: int = 1) -> None:
        """Send records one a datagram, all zeros."""
        self.send(*(record(rdt + i, ft + i * step) for i in range(count)))

    def wait_for(self, command: int, count: int = 1, timeout: float = LONG) -> None:
        """Wait until so many requests with a command have come."""
        deadline = time.monotonic() + timeout
        while sum(c == command for c, _ in self.requests) < count:
            assert time.monotonic() < deadline, f"no request {command:#x}: {self.requests}"
            time.sleep(0.002)

    def was_asked(self, command: int) -> bool:
        """Return whether such a request has come."""
        return any(asked == command for asked, _ in self.requests)

    def reboot(self) -> None:
        """Lose the client and begin to count anew."""
        self.client = None
        self._booted = time.monotonic()

    def steal(self) -> None:
        """Send to nobody until the stream is asked for again, as if another client had asked."""
        self.client = None

    def _feed(self) -> None:
        client = self.client
        if client is None or not self.rate:
            return
        due = int((time.monotonic() - self._begun) * self.rate)
        step = round(self.tick_rate / self.rate)
        while self.sent < due:
            self.sent += 1
            if not self.frozen:
                before = int((self._begun - self._booted) * self.tick_rate)
                self._ticks = before + self.sent * step
            first, *others = self.counts
            counts = (first + self.sent * self.drift, *others)
            data = record(self.sent, self._ticks, self.status, counts)
            self.socket.sendto(data, client)

    def _run(self) -> None:
        while not self._ended.is_set():
            self._feed()
            try:
                data, address = self.socket.recvfrom(64)
            except TimeoutError:
                continue
            except OSError as error:
                if error.errno == errno.ECONNREFUSED:
                    continue
                raise
            header, command, count = struct.unpack(">HHI", data)
            assert header == 0x1234
            acts = time.monotonic() + self.late
            while time.monotonic() < acts:
                self._feed()
                time.sleep(0.001)
            if command in (1, 2, 3):
                self.client, self._begun, self.sent = address, time.monotonic(), 0
            elif command == 0:
                self.client = None
            self.requests.append((command, count))
            if command in (1, 2, 3) and self.on_start is not None:
                self.on_start(command)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self.socket.close()
