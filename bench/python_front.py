"""A program on the plain Python front that streams servo_jp; no ROS.

front_sent     for each command: its last joint's position, monotonic time (ns) before the call
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import crtk_drivers
from bench.recording import Recording
from bench.ros_client import SERVO_STEP


def main() -> None:
    """Stream for as long as the options say."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", required=True)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--control", default="ur_rtde")
    options = parser.parse_args()
    sent = Recording("front_sent", 2)
    with crtk_drivers.connect("ur", host=options.host, control=options.control) as arm:
        arm.enable()
        print("ready", time.monotonic(), flush=True)
        start = np.array(arm.measured_js().position)
        target, due = start.copy(), time.monotonic()
        for step in range(int(options.seconds * options.rate)):
            target[-1] = start[-1] + SERVO_STEP * (step % 10_000)
            sent.add((target[-1], time.monotonic_ns()))
            arm.servo_jp(target)
            due += 1.0 / options.rate
            time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main()
