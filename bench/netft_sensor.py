"""A sensor for figures: RDT records at an exact rate, each with the time of its measurement in it.

Prints its port. The first two counts of a record are the time at which it was due, on the monotonic clock, in
seconds and nanoseconds: what comes out of a client can be compared with it. Records that are late are sent in
a burst; none is left out.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import time

RECORD = struct.Struct(">III6i")


def main() -> None:
    """Serve until killed: the rate in Hz is the first argument."""
    rate = float(sys.argv[1])
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    except PermissionError:
        print("no real-time priority: the rate will be uneven", file=sys.stderr)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here:
        here.bind(("127.0.0.1", 0))
        here.setblocking(False)
        print(here.getsockname()[1], flush=True)
        serve(here, rate)


def serve(here: socket.socket, rate: float) -> None:
    """Answer requests and send records."""
    booted = begun = time.monotonic()
    client: tuple[str, int] | None = None
    sent = first_tick = 0
    while True:
        try:
            request, address = here.recvfrom(64)
            _, command, _ = struct.unpack(">HHI", request[:8])
            client = None if command == 0 else address
            begun, sent = time.monotonic(), 0
            first_tick = round((begun - booted) * rate)
        except BlockingIOError:
            pass
        except ConnectionRefusedError:
            client = None
        if client is None:
            time.sleep(0.001)
            continue
        due = int((time.monotonic() - begun) * rate)
        while sent < due:
            sent += 1
            when = begun + sent / rate
            whole = int(when)
            ns = int((when - whole) * 1e9)
            here.sendto(RECORD.pack(sent, first_tick + sent, 0, whole, ns, 0, 0, 0, 0), client)
        time.sleep(max(2e-5, begun + (sent + 1) / rate - time.monotonic()))


if __name__ == "__main__":
    main()
