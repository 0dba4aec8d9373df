"""How frames get to and from a bus that python-can has opened.

python-can makes an object with eleven fields of each frame, which takes most of the time of a cycle. Where
its bus gives access to the bytes of frames (SocketCAN, the project's own hub) they are exchanged as such.
"""

from __future__ import annotations

import select
import socket
import struct
from collections.abc import Sequence
from typing import Any, Final, Protocol

import can
from can.interfaces.socketcan import SocketcanBus

from crtk_driver_canopen.bus_state import Condition, condition_of_error
from crtk_driver_canopen.frames import ERROR, EXTENDED, REMOTE, Frame, pack, unpack
from crtk_drivers.kit.readable_files import is_readable


class Port(Protocol):
    """Exchanges the frames of one bus. Belongs to one thread."""

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames; return how many of them, from the first on, there was room for.

        Raises:
            can.CanError, OSError: the bus cannot be used.
        """
        ...

    def receive(self, timeout: float) -> Sequence[Frame]:
        """Return the next frame, or some that have come together; none when none came in time.

        Args:
            timeout: seconds; 0 or less: only what is there already.

        Raises:
            can.CanError, OSError: the bus cannot be used.
        """
        ...


def port_of(bus: can.BusABC) -> Port:
    """Return the fastest port that a bus has."""
    if isinstance(bus, SocketcanBus):
        return SocketPort(bus.socket)
    if hasattr(bus, "send_frames") and hasattr(bus, "recv_frames"):
        return HubPort(bus)
    return MessagePort(bus)


class MessagePort:
    """By python-can's messages, as every interface of it can."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._receives_itself = type(bus).recv is not can.BusABC.recv
        self._descriptor = _descriptor(bus)

    def send(self, frames: Sequence[Frame]) -> int:
        """Send one after the other; see `Port.send`."""
        for count, frame in enumerate(frames):
            try:
                self._bus.send(message_of(frame))
            except (can.CanError, OSError) as error:
                if condition_of_error(error) is not Condition.FULL:
                    raise
                return count
        return len(frames)

    def receive(self, timeout: float) -> Sequence[Frame]:
        """Return the next frame; see `Port.receive`."""
        message = self._next(timeout)
        return () if message is None else (_frame_of(message),)

    def _next(self, timeout: float) -> can.Message | None:
        message = self._take(0.0)
        if message is not None or timeout <= 0.0:
            return message
        if self._descriptor < 0:
            message = self._take(timeout)
        elif is_readable(self._descriptor, timeout):
            message = self._take(0.0)
        return message

    def _take(self, timeout: float) -> can.Message | None:
        """Receive as `can.BusABC.recv` does, which waits on if the clock of the day goes back meanwhile."""
        bus = self._bus
        if self._receives_itself:
            return bus.recv(timeout)
        message, filtered = bus._recv_internal(timeout)  # noqa: SLF001 - what an interface of python-can is made of
        if message is None or filtered or bus._matches_filters(message):  # noqa: SLF001
            return message
        return None


def _descriptor(bus: can.BusABC) -> int:
    """Return what can be waited on with a monotonic deadline; -1 for an interface without."""
    try:
        return int(bus.fileno())
    except (NotImplementedError, can.CanError):
        return -1


def message_of(frame: Frame) -> can.Message:
    """Return a data frame as python-can's message, to be sent."""
    return can.Message(
        arbitration_id=frame.can_id, data=frame.data, is_extended_id=False, is_rx=False
    )


def _frame_of(message: can.Message) -> Frame:
    flags = (
        EXTENDED * message.is_extended_id | REMOTE * message.is_remote_frame
        | ERROR * message.is_error_frame
    )  # fmt: skip
    data = bytes(message.data)
    return Frame(message.arbitration_id | flags, data, not message.is_rx, message.timestamp)


class _Readable:
    """Whether there is something to be received: asking takes a quarter of the time of receiving in vain."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)

    def within(self, timeout: float) -> bool:
        """Wait for at most `timeout` seconds; 0 or less: not at all."""
        if timeout <= 0.0:
            return bool(self._poll.poll(0))
        return is_readable(self._descriptor, timeout)


_TIMESPEC: Final = struct.Struct("@ll")
_SO_TIMESTAMPNS: Final = 35  # asm-generic/socket.h
_ANCILLARY: Final = socket.CMSG_SPACE(_TIMESPEC.size)
_LARGEST: Final = 72
"""Bytes of a CAN FD frame (CANFD_MTU, linux/can.h)."""


class SocketPort:
    """By the raw socket of SocketCAN that python-can has opened, with the time stamps of the kernel."""

    def __init__(self, raw: socket.socket) -> None:
        self._socket = raw
        self._readable = _Readable(raw.fileno())

    def send(self, frames: Sequence[Frame]) -> int:
        """Send one after the other; see `Port.send`."""
        send = self._socket.send
        for count, frame in enumerate(frames):
            try:
                send(pack(frame), socket.MSG_DONTWAIT)
            except OSError as error:
                if condition_of_error(error) is not Condition.FULL:
                    raise
                return count
        return len(frames)

    def receive(self, timeout: float) -> Sequence[Frame]:
        """Return the next frame; see `Port.receive`."""
        if not self._readable.within(timeout):
            return ()
        try:
            raw, ancillary, flags, _ = self._socket.recvmsg(
                _LARGEST, _ANCILLARY, socket.MSG_DONTWAIT
            )
        except BlockingIOError:
            return ()
        seconds = 0.0
        for level, kind, data in ancillary:
            if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
                whole, nanoseconds = _TIMESPEC.unpack(data)
                seconds = whole + nanoseconds * 1e-9
        # The kernel marks what was sent by this computer so (Documentation/networking/can.rst, 4.1.7).
        return (unpack(raw, bool(flags & socket.MSG_DONTROUTE), seconds),)


class HubPort:
    """By the packets of the project's own hub, in which several frames can be (docs/can_hub.md)."""

    def __init__(self, bus: Any) -> None:
        self._bus = bus
        self._readable = _Readable(bus.fileno())

    def send(self, frames: Sequence[Frame]) -> int:
        """Send them together; see `Port.send`."""
        count: int = self._bus.send_frames(b"".join(map(pack, frames)))
        return count

    def receive(self, timeout: float) -> Sequence[Frame]:
        """Return all that are there; see `Port.receive`."""
        if not self._readable.within(timeout):
            return ()
        return [
            Frame(can_id, data[:length], bool(own))
            for can_id, length, own, data in _HUB_FRAME.iter_unpack(self._bus.recv_frames())
        ]


_HUB_FRAME: Final = struct.Struct("=IBB2x8s")
"""`struct can_frame`, in whose padding a byte tells whether it comes back to its sender."""
