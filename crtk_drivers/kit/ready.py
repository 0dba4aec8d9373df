"""Wait for a file descriptor or a connection, no longer than the program lets a device be opened."""

from __future__ import annotations

import errno
import os
import select
import socket
import time
from collections.abc import Callable
from typing import Any, Final

from crtk_drivers.device.giving_up import GIVEN_UP, is_given_up

__all__ = ["await_connection", "is_ready"]

_PIECE: Final = 0.05
"""Seconds after which a wait looks whether it is given up."""


def is_ready(
    poll: select.poll,
    deadline: float,
    clock: Callable[[], float] = time.monotonic,
    given_up: Callable[[], bool] = is_given_up,
) -> bool:
    """Return whether what `poll` waits for is there, at the `deadline` of the clock at the latest.

    Args:
        poll: has what is waited for.
        deadline: what is there is told also when this is past.
        clock: seconds.
        given_up: asked every now and then: whether to wait no longer.

    Raises:
        OSError: it was given up (ECANCELED).
    """
    while not given_up():
        left = deadline - clock()
        if poll.poll(1000.0 * max(0.0, min(left, _PIECE))):
            return True
        if left <= 0.0:
            return False
    raise OSError(errno.ECANCELED, GIVEN_UP)


def await_connection(peer: socket.socket, address: Any, is_writable: Callable[[], bool]) -> None:
    """Connect a socket, and wait until the other side has accepted. The socket blocks no more.

    Args:
        peer: the new socket, with its options.
        address: as `socket.socket.connect` takes it.
        is_writable: waits until the socket can be written to; returns False if it cannot in time.

    Raises:
        TimeoutError: no answer in time.
        OSError: refused, no route, or given up.
    """
    peer.setblocking(False)
    code = peer.connect_ex(address)
    if code == errno.EINPROGRESS:
        if not is_writable():
            raise TimeoutError(errno.ETIMEDOUT, "no connection in time")
        code = peer.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if code:
        raise OSError(code, os.strerror(code))
