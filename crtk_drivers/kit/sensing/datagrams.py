"""Datagrams with the time of their arrival, many at a time.

A stream of 7000 datagrams a second is too much to be taken one by one by Python beside other threads: each
system call that gives the interpreter lock away waits for it to come back, up to the switch interval (5 ms).
`recvmmsg` takes all that has arrived in one call, into memory that was set aside once, and is called without
giving the lock away, since it does not wait.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import socket
import struct
import sys
import time
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from crtk_drivers.kit.clock_fit import WallClock

MOST: Final = 512
"""Datagrams taken at once."""
SLOT: Final = 1536
"""Bytes of a datagram; a longer one is cut and its length says so."""

_FLAGS: Final = int(socket.MSG_DONTWAIT | socket.MSG_TRUNC)
_SO_TIMESTAMP: Final = 29
_SO_TIMESTAMPNS: Final = 35
_TIME: Final = struct.Struct("@ll")
"""``struct timeval`` of 64-bit Linux."""
_SO_RCVBUFFORCE: Final = 33
_CONTROL_SIZE: Final = 64
_CLOCK_STEP: Final = 0.001
"""Seconds by which the wall clock moves between two calls only when somebody sets it."""


class Datagrams(NamedTuple):
    """What arrived: `slots` (n, SLOT) bytes, valid until the next call; `lengths` and `arrivals` (n,).

    Arrivals are monotonic seconds, of the kernel where it tells them, and do not descend.
    """

    slots: NDArray[np.uint8]
    lengths: NDArray[np.uint32]
    arrivals: NDArray[np.float64]


class _Arrivals:
    """From the kernel's stamps to the monotonic clock."""

    def __init__(self) -> None:
        self._wall_clock = WallClock()
        self._offset: int | None = None
        self._looked = 0.0

    def of(self, wall_ns: NDArray[np.int64], count: int) -> NDArray[np.float64]:
        """Return when so many datagrams arrived (count,), monotonic s.

        Args:
            wall_ns: their stamps, in ns since the epoch; fewer than `count`: some have none.
            count: of the datagrams.
        """
        offset = self._wall_clock.offset()
        now = time.monotonic()
        before, self._offset = self._offset, offset
        looked, self._looked = self._looked, now
        if len(wall_ns) < count:
            return np.full(count, now)
        arrivals = _monotonic(wall_ns, offset)
        if before is not None and abs(offset - before) > _CLOCK_STEP * 1e9:
            # The clock was set: some may have been stamped before, and some after.
            arrivals = _earliest_between(looked, now, arrivals, _monotonic(wall_ns, before))
        if arrivals[0] > arrivals[-1] or arrivals[-1] > now:
            arrivals = np.maximum.accumulate(np.minimum(arrivals, now))
        return arrivals


def _monotonic(wall_ns: NDArray[np.int64], offset: int) -> NDArray[np.float64]:
    """Return the monotonic s of stamps of a wall clock that is `offset` ns ahead."""
    return np.multiply(wall_ns - offset, 1e-9, dtype=np.float64)


def _earliest_between(begin: float, end: float, *times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the earliest of several times (n,) each, of those from `begin` to `end`; `end` if none is."""
    possible = [np.where((each >= begin) & (each <= end), each, end) for each in times]
    found: NDArray[np.float64] = np.minimum.reduce(possible)
    return found


class Receiver(Protocol):
    """Takes what has arrived, without waiting."""

    kernel_stamps: bool
    """Whether arrivals are the kernel's; otherwise they are the time of the call."""

    def receive(self) -> Datagrams | None:
        """Return what has arrived, None if nothing has.

        Raises:
            OSError: the socket's error: `errno.ECONNREFUSED` if the peer's port is closed.
        """


class BatchReceiver:
    """By `recvmmsg` (64-bit Linux).

    Args:
        peer: a UDP socket, which stays the caller's.
    """

    def __init__(self, peer: socket.socket) -> None:
        self.kernel_stamps = True
        self._fd = peer.fileno()
        self._data = np.zeros((MOST, SLOT), np.uint8)
        self._control = np.zeros((MOST, _CONTROL_SIZE // 8), np.int64)
        self._vectors = (_IoVector * MOST)()
        self._headers = (_MessageHeader * MOST)()
        for i in range(MOST):
            self._vectors[i].base = self._data.ctypes.data + i * SLOT
            self._vectors[i].length = SLOT
            header = self._headers[i]
            header.vectors = ctypes.addressof(self._vectors) + i * ctypes.sizeof(_IoVector)
            header.vector_count = 1
            header.control = self._control.ctypes.data + i * _CONTROL_SIZE
        # Two fields of all headers: what the kernel wrote, and what it is told before.
        fields = np.frombuffer(memoryview(self._headers), _HEADER_FIELDS)
        self._control_lengths = fields["control_length"]
        self._lengths = fields["length"]
        self._control_lengths[:] = _CONTROL_SIZE
        self._call = ctypes.PyDLL(None, use_errno=True).recvmmsg
        self._call.argtypes = (
            ctypes.c_int,
            ctypes.c_void_p,
            ctypes.c_uint,
            ctypes.c_int,
            ctypes.c_void_p,
        )
        self._address = ctypes.addressof(self._headers)
        self._arrivals = _Arrivals()
        peer.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)

    def receive(self) -> Datagrams | None:
        """See `Receiver`."""
        count = self._call(self._fd, self._address, MOST, _FLAGS, None)
        if count < 0:
            code = ctypes.get_errno()
            if code in (errno.EAGAIN, errno.EINTR):
                return None
            raise OSError(code, os.strerror(code))
        told = self._control[:count][self._control_lengths[:count] > 0]
        arrivals = self._arrivals.of(told[:, 2] * 1_000_000_000 + told[:, 3], count)
        self._control_lengths[:count] = _CONTROL_SIZE
        return Datagrams(self._data[:count], self._lengths[:count], arrivals)


class _IoVector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _MessageHeader(ctypes.Structure):
    """``struct mmsghdr`` of Linux: a ``struct msghdr`` and the length of what was received."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("vectors", ctypes.c_void_p),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
        ("padding", ctypes.c_int),
        ("length", ctypes.c_uint32),
    )


_HEADER_FIELDS: Final = np.dtype(
    {
        "names": ["control_length", "length"],
        "formats": [np.uint64, np.uint32],
        "offsets": [_MessageHeader.control_length.offset, _MessageHeader.length.offset],
        "itemsize": ctypes.sizeof(_MessageHeader),
    }
)


class PlainReceiver:
    """One by one, where there is no `recvmmsg`; stamped to the microsecond, where the system does that.

    Args:
        peer: a non-blocking UDP socket, which stays the caller's.
    """

    def __init__(self, peer: socket.socket) -> None:
        self._peer = peer
        self._data = np.zeros((MOST, SLOT), np.uint8)
        self._rows = [row.data for row in self._data]
        self._lengths = np.zeros(MOST, np.uint32)
        self._arrivals = _Arrivals()
        self.kernel_stamps = sys.platform == "linux" and sys.maxsize > 1 << 32
        if self.kernel_stamps:
            peer.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMP, 1)

    def receive(self) -> Datagrams | None:
        """See `Receiver`."""
        count = 0
        stamps: list[int] = []
        try:
            for row in self._rows:
                data, told, *_ = self._peer.recvmsg(SLOT, socket.CMSG_SPACE(_TIME.size))
                row[: len(data)] = data
                self._lengths[count] = len(data)
                stamps += [_nanoseconds(stamp) for _, kind, stamp in told if kind == _SO_TIMESTAMP]
                count += 1
        except BlockingIOError:
            pass
        except OSError:
            if not count:
                raise
        if not count:
            return None
        arrivals = self._arrivals.of(np.array(stamps, np.int64), count)
        return Datagrams(self._data[:count], self._lengths[:count], arrivals)


def _nanoseconds(stamp: bytes) -> int:
    seconds, micros = _TIME.unpack(stamp)
    return 1_000_000_000 * int(seconds) + 1000 * int(micros)


def receiver_for(peer: socket.socket) -> Receiver:
    """Return the receiver for a non-blocking UDP socket on this machine."""
    batches: Any = sys.platform == "linux" and sys.maxsize > 1 << 32
    if batches:
        with contextlib.suppress(
            OSError
        ):  # of a system that does not stamp datagrams, a simulated one
            return BatchReceiver(peer)
    return PlainReceiver(peer)


def ask_for_buffer(peer: socket.socket, size: int) -> int:
    """Ask for a receive buffer of `size` bytes and return how many it got.

    More than ``net.core.rmem_max`` takes a privilege that the process may have.
    """
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
    if sys.platform == "linux" and _buffer_of(peer) < size:
        with contextlib.suppress(PermissionError):
            peer.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, size)
    return _buffer_of(peer)


def _buffer_of(peer: socket.socket) -> int:
    size = peer.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    return size // 2 if sys.platform == "linux" else size  # Linux doubles it for its own needs
