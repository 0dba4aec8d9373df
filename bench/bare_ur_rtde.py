"""The peer of `bench.ur_loop`: a plain loop over ur-rtde that reads the same six things.

bare     for each cycle: monotonic time at its end, controller's time stamp
"""

from __future__ import annotations

import argparse
import time

from rtde_receive import RTDEReceiveInterface

from bench.recording import Recording

VARIABLES = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "target_q",
    "target_qd",
    "actual_TCP_pose",
    "target_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
]


def main() -> None:
    """Read for as long as the options say."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", required=True)
    parser.add_argument("--seconds", type=float, required=True)
    options = parser.parse_args()
    recording = Recording("bare", 2)
    receive = RTDEReceiveInterface(options.host, 500.0, VARIABLES)
    print("ready", time.monotonic(), flush=True)
    end = time.monotonic() + options.seconds
    while (now := time.monotonic()) < end:
        period = receive.initPeriod()
        receive.getActualQ(), receive.getActualQd(), receive.getTargetQ(), receive.getTargetQd()
        receive.getActualTCPPose(), receive.getTargetTCPPose()
        receive.getActualTCPSpeed(), receive.getActualTCPForce()
        recording.add((now, receive.getTimestamp()))
        receive.waitPeriod(period)
    receive.disconnect()


if __name__ == "__main__":
    main()
