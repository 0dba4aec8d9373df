"""One driver in a process of its own: its CPU, the lateness of its I/O thread, and what it records.

Prints one line of JSON.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import numpy as np

import crtk_drivers

SETTLE = 6.0
"""Seconds after which the black box is full."""


def main() -> None:
    """Run a virtual arm at 500 Hz for some seconds, as it is told: bare, with black box, recorded."""
    how, seconds, folder = sys.argv[1], float(sys.argv[2]), Path(sys.argv[3])
    recording = {"folder": str(folder) if how != "bare" else ""}
    with crtk_drivers.connect("virtual", rate=500.0, recording=recording) as arm:
        arm.enable()
        if how == "recorded":
            arm.recordings.start(folder / f"{os.getpid()}.mcap")
        time.sleep(SETTLE)
        times: list[float] = []
        arm.engine.on_sample = lambda: times.append(time.perf_counter())
        cpu, began = time.process_time(), time.perf_counter()
        time.sleep(seconds)
        cpu = time.process_time() - cpu
        passed = time.perf_counter() - began
        arm.engine.on_sample = None
        late = np.abs(np.diff(times) - 1.0 / 500.0)
        found = {
            "cpu": cpu / passed,
            "samples": len(times) / passed,
            "late": np.percentile(late, (50, 99, 100)).tolist(),
        }
        if how == "recorded":
            totals = arm.recordings.stop(60.0)
            found |= {"written": totals.written, "lost": totals.lost, "size": totals.size}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
