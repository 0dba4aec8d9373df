"""A peer that speaks OpenIGTLink by hand: its own headers, checksums and bodies, nothing of the bridge's."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple, Self

import numpy as np

from crtk_drivers.front import LocalDevice
from crtk_drivers.front.openigtlink import Bridge, Server
from crtk_drivers.samples import Array
from rigs.waiting import LONG

HEADER = struct.Struct(">H12s20sQQQ")


def checksum(data: bytes) -> int:
    """CRC-64/ECMA-182, bit by bit."""
    value = 0
    for byte in data:
        value ^= byte << 56
        for _ in range(8):
            value = (value << 1) ^ (0x42F0E1EBA9EA3693 if value >> 63 else 0)
            value &= 0xFFFFFFFFFFFFFFFF
    return value


def framed(
    kind: str, device: str, body: bytes = b"", version: int = 1, seconds: float = 0.0
) -> bytes:
    """A message of bytes, stamped with so many seconds."""
    stamp = round(seconds * 2**32)
    head = HEADER.pack(version, kind.encode(), device.encode(), stamp, len(body), checksum(body))
    return head + body


def transform(matrix: Array) -> bytes:
    """The body of a TRANSFORM."""
    return struct.pack(">12f", *matrix[:3].T.ravel())


def sensor(*values: float) -> bytes:
    """The body of a SENSOR."""
    return struct.pack(f">BBQ{len(values)}d", len(values), 0, 0, *values)


def string(text: str) -> bytes:
    """The body of a STRING."""
    return struct.pack(">HH", 3, len(text)) + text.encode()


def at(x: float, y: float, z: float) -> Array:
    """A matrix that moves and does not turn."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


class Got(NamedTuple):
    """A message as it arrived; of version 2 with its header and metadata in the body."""

    version: int
    kind: str
    device: str
    time: int
    body: bytes

    @property
    def matrix(self) -> Array:
        """Of a TRANSFORM."""
        matrix = np.eye(4)
        matrix[:3] = np.reshape(struct.unpack(">12f", self.body), (4, 3)).T
        return matrix

    @property
    def text(self) -> str:
        """Of a STRING, or a STATUS."""
        at = 4 if self.kind == "STRING" else 30
        return self.body[at:].rstrip(b"\0").decode()


class IgtlPeer:
    """A connected peer."""

    def __init__(self, peer: socket.socket) -> None:
        self.socket = peer
        self.socket.settimeout(LONG)

    @classmethod
    def connected(cls, port: int) -> Self:
        """One that has connected to a server on this machine."""
        return cls(socket.create_connection(("127.0.0.1", port), LONG))

    def close(self) -> None:
        self.socket.close()

    def send(
        self, kind: str, device: str, body: bytes = b"", version: int = 1, seconds: float = 0.0
    ) -> None:
        self.socket.sendall(framed(kind, device, body, version, seconds))

    def _take(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            piece = self.socket.recv(size - len(data))
            if not piece:
                raise EOFError("disconnected")
            data += piece
        return data

    def next(self) -> Got:
        """The next message."""
        version, kind, device, time_, size, crc = HEADER.unpack(self._take(HEADER.size))
        body = self._take(size)
        assert crc == checksum(body)
        return Got(version, kind.rstrip(b"\0").decode(), device.rstrip(b"\0").decode(), time_, body)

    def until(self, kind: str, device: str | None = None) -> Got:
        """The next message of a type, and of a name; others are passed over."""
        end = time.monotonic() + LONG
        while time.monotonic() < end:
            got = self.next()
            if got.kind == kind and device in (None, got.device):
                return got
        raise AssertionError(f"no {kind} of {device} within {LONG:g} s")

    def is_sent_away(self) -> bool:
        """Whether the other side disconnects, whatever it still has to say."""
        try:
            while self.socket.recv(65536):
                pass
        except ConnectionResetError:
            pass
        return True


@contextmanager
def served(devices: Mapping[str, LocalDevice], **options: Any) -> Iterator[tuple[Bridge, Server]]:
    """A bridge of devices in this process, and its server at any free port."""
    with Bridge(devices, **options) as bridge:
        server = Server(bridge, port=0)
        server.start()
        try:
            yield bridge, server
        finally:
            server.close()
