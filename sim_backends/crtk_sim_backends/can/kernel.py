"""A CAN interface of the kernel joined to the bus: what is on either is on both.

So simulated devices appear on vcan0, or among real ones on can0. Linux, SocketCAN (linux/can/raw.h).
The kernel's side has a pace of its own: a hub that is joined to it usually has no bit rate.
"""

from __future__ import annotations

import errno
import logging
import os
import socket
from typing import Final

from crtk_sim_backends.can import frames
from crtk_sim_backends.can.node import Bus
from crtk_sim_backends.can.port import State
from crtk_sim_backends.process import SimStartError

_FRAMES_AT_ONCE: Final = 64  # then the others have their turn
_ERROR_FILTER: Final = 2  # CAN_RAW_ERR_FILTER, which the socket module does not have
_ALL_ERRORS: Final = 0x1FFFFFFF  # CAN_ERR_MASK

log = logging.getLogger(__name__)


class KernelDoor:
    """The hub's node at the other end of an interface of the kernel.

    Raises:
        SimStartError: when the kernel has no CAN, or no such interface, or it is down.
    """

    def __init__(self, hub: Bus, interface: str) -> None:
        self.interface = interface
        self._hub = hub
        self._up = True
        self._socket = _open(interface)
        self._fd = self._socket.fileno()
        self.node = hub.add(interface, self)
        hub.loop.watch(self._fd, self._readable)

    def _readable(self, events: int) -> None:
        for _ in range(_FRAMES_AT_ONCE):
            try:
                raw = self._socket.recv(frames.SIZE)
            except BlockingIOError:
                return
            except OSError as error:
                self._failed(error)
                return
            self._up = True
            can_id, data = frames.unpack(raw)
            if can_id & frames.ERROR:
                self._hub.error(can_id & frames.EXTENDED_MASK, data)
            elif frames.fault_of(raw) is None:
                self._hub.transmit(self.node, raw)
            else:
                self.node.counters.invalid += 1

    def deliver(self, raw: bytes) -> None:
        """Send a frame on the interface, or lose it when that does not take it."""
        if raw[3] & frames.ERROR >> 24:
            return  # a node cannot send one
        try:
            self._socket.send(raw)
        except (BlockingIOError, OSError) as error:
            self.node.counters.missed += 1
            if error.errno not in (errno.EAGAIN, errno.ENOBUFS):
                self._failed(error)
            return
        self._up = True

    def _failed(self, error: OSError) -> None:
        """Tell once that the interface is gone; frames pass again when it is back."""
        if self._up:
            log.warning(
                "%s: %s; its frames are lost until it is up", self.interface, error.strerror
            )
        self._up = False
        if error.errno == errno.ENODEV:
            self.close()

    def state_changed(self, state: State) -> None:
        """Do nothing: the kernel's side has a state of its own."""

    def waiting(self, count: int) -> None:
        """Do nothing: the kernel's side is not told."""

    def close(self) -> None:
        """Leave the bus and close the socket; safe to repeat."""
        self.node.detach()
        self._hub.loop.forget(self._fd)
        self._socket.close()


def _open(interface: str) -> socket.socket:
    try:
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except (AttributeError, OSError) as error:
        raise SimStartError(
            f"cannot join {interface}: this kernel has no CAN ({error}); leave the interface out"
        ) from error
    try:
        sock.setsockopt(socket.SOL_CAN_RAW, _ERROR_FILTER, _ALL_ERRORS)
        sock.bind((interface,))
        if not _is_up(interface):
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))
        sock.setblocking(False)
    except OSError as error:
        sock.close()
        raise SimStartError(
            f"cannot join {interface}: {error.strerror}; `ip link` lists the interfaces, and "
            f"`ip link set {interface} up` brings one up"
        ) from error
    return sock


def _is_up(interface: str) -> bool:
    with open(f"/sys/class/net/{interface}/flags", encoding="ascii") as file:
        return bool(int(file.read(), 16) & 1)  # IFF_UP
