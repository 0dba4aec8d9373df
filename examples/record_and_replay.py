"""Record what an arm does into a CSV file, and let it do that again.

While it is recorded the arm is moved by this script; with a real arm call `arm.free()` and move it by hand.

python examples/record_and_replay.py                    # a simulated UR5e in this process
python examples/record_and_replay.py /ur5               # whatever runs in that ROS 2 namespace
python examples/record_and_replay.py /ur5 motion.csv    # keep the recording
"""

import csv
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import crtk_drivers
from crtk_drivers import client

RATE = 50.0


def open_arm() -> crtk_drivers.Arm:
    """Return the device that the command line asks for."""
    if len(sys.argv) > 1:
        return client.connect(sys.argv[1])
    return crtk_drivers.connect("ur", sim=True)


def record(arm: crtk_drivers.Arm, path: Path, moves: Iterable[NDArray[np.float64]]) -> None:
    """Write time and joint positions until the moves have ended."""
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time", *arm.measured_js().name])
        begin = due = time.monotonic()
        for goal in moves:
            move = arm.move_jp(goal)
            while move.is_busy():
                rows.writerow([due - begin, *arm.measured_jp(age=0)])
                due += 1.0 / RATE
                time.sleep(max(0.0, due - time.monotonic()))


def replay(arm: crtk_drivers.Arm, path: Path) -> float:
    """Follow a recording; return by how much the arm was off, in rad."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    times, positions = np.array(rows, dtype=float)[:, 0], np.array(rows, dtype=float)[:, 1:]
    arm.move_jp(positions[0]).wait()
    off, late = 0.0, 2.0 / RATE  # interpolation is one input period late
    begin = time.monotonic()
    for due, position in zip(times, positions, strict=True):
        time.sleep(max(0.0, begin + due - time.monotonic()))
        arm.interpolate_jp(position)
        if due > late:
            expected = [np.interp(due - late, times, joint) for joint in positions.T]
            off = max(off, float(np.abs(arm.setpoint_jp(age=0) - expected).max()))
    time.sleep(0.6)
    return max(off, float(np.abs(arm.setpoint_jp(age=0) - positions[-1]).max()))


with tempfile.TemporaryDirectory() as folder, open_arm() as arm:
    path = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(folder) / "motion.csv"
    arm.enable()
    start = arm.setpoint_jp()
    there = start + np.radians([20, -5, 5, 0, 0, 10])
    record(arm, path, [there, start])
    print("recorded", len(path.read_text().splitlines()) - 1, "rows")
    off = replay(arm, path)
    print(f"replayed, at most {np.degrees(off):.1f} degrees off")
