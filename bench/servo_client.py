"""A 500 Hz client of a UR controller: ur-rtde's servoJ in a circle of a degree, until it is ended."""

from __future__ import annotations

import argparse
import math
import signal
import threading
import time

from rtde_control import RTDEControlInterface

START = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
RATE = 500.0
SIZE = math.radians(1.0)


def main() -> None:
    """Move until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", required=True)
    options = parser.parse_args()
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    control = RTDEControlInterface(options.host, RATE)
    print("ready", time.monotonic(), flush=True)
    count = 0
    while not ended.is_set():
        period = control.initPeriod()
        turn = SIZE * math.sin(2.0 * math.pi * count / RATE)
        control.servoJ([START[0] + turn, *START[1:]], 0.0, 0.0, 1.0 / RATE, 0.1, 300.0)
        control.waitPeriod(period)
        count += 1
    control.servoStop()
    control.stopScript()


if __name__ == "__main__":
    main()
