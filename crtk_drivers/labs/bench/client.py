"""A client of a device in a process of its own, for tests that kill it.

``python -m crtk_drivers.labs.bench.client`` takes a pickled `ClientOrder` from its standard input, brings all
joints into motion by a stream, and then says no more, but does not leave either.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading
import time
from typing import Final

from crtk_drivers.labs.bench import programs
from crtk_drivers.labs.bench.bed import paced
from crtk_drivers.labs.bench.calls import ClientOrder
from crtk_drivers.labs.bench.door import Door
from crtk_drivers.labs.bench.stops import RUN, motion

PRESENCE: Final = 30.0
"""Seconds that it stays, if nobody kills it."""

OPEN_TIMEOUT: Final = 5.0


def start_client(order: ClientOrder) -> subprocess.Popen[bytes]:
    """Start the process of an order."""
    return programs.start(__name__, order=order)


def main() -> int:
    """Carry out the order that comes on standard input; return the exit code."""
    order: ClientOrder = pickle.load(sys.stdin.buffer)
    value = motion(order.command, order.home, order.speed)
    with Door(order.door, order.key, OPEN_TIMEOUT) as door:
        for t in paced(order.rate, RUN):
            door.submit(order.command, value(t), time.time_ns())
        threading.Event().wait(PRESENCE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
