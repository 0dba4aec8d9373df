"""How long this machine takes to bring bytes through a pseudo-terminal to a process that sleeps, and back.

A client of the simulated bus pays this for every transaction, and no real bus asks for it. The simulator
is ahead of its own time by as much, so that a client gets its bytes when a real bus would have given
them.
"""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from typing import Final

_ROUNDS: Final = 80
_PAUSE: Final = 0.0007  # s between two rounds, of which both sides sleep most
_SPIN: Final = 0.0001  # s before a round for which this side does not sleep, as before a delivery
_LONGEST: Final = 0.00012  # s; more than that is not the way of the bytes


def measure() -> float:
    """Return the time there and back, s, between two processors. Takes about 0.1 s.

    The lower quartile: other load of the machine makes bytes late here as at a real bus.
    """
    allowed = os.sched_getaffinity(0)
    master, slave = os.openpty()
    tty.setraw(slave)
    other = threading.Thread(target=_echo, args=(slave, {max(allowed)}), name="wake-up")
    other.start()
    os.sched_setaffinity(0, {min(allowed)})
    try:
        rounds = sorted(_round(master) for _ in range(_ROUNDS))
        return min(_LONGEST, rounds[_ROUNDS // 4])
    finally:
        os.sched_setaffinity(0, allowed)
        os.write(master, b"q")
        other.join()
        os.close(slave)
        os.close(master)


def _round(master: int) -> float:
    due = time.monotonic() + _PAUSE
    select.select((), (), (), _PAUSE - _SPIN)
    while (started := time.monotonic()) < due:
        pass
    os.write(master, b"?")
    select.select((master,), (), (), 1.0)
    os.read(master, 16)
    return time.monotonic() - started


def _echo(slave: int, processors: set[int]) -> None:
    os.sched_setaffinity(0, processors)  # of this thread
    while True:
        select.select((slave,), (), ())
        if os.read(slave, 16) == b"q":
            return
        os.write(slave, b"!")
