"""What a line of Copley drives carries, and how an axis follows servo_jp: PVT, profiles, from rest to rest.

Simulated drives whose answers take the time that their bytes need at 115200 bit/s, and 1 ms in the drive; the
motor is 4 ms behind its trajectory. First the cycles of the driver beside a bare loop with pyserial that asks
the same questions, then, for each way of following, a sine of 1 Hz by one axis, setpoints at 250 Hz. Delay is
what the measured positions are best shifted by; error is what is left then.

    python -m bench.copley_pvt
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import serial

from bench.galil_tracking import follow, judged
from bench.motor_arm import arm_at
from crtk_driver_copley import PLUGIN
from crtk_driver_copley.plugin import TYPICAL
from crtk_sim_backends.copley import SIM, RunningSim

SETTLED = 3.0
"""Seconds after which a stream has caught up with what its start has taken."""
QUESTIONS = ("g r0xa0", "g r0x32", "g r0x18", "g r0xc9")
"""Of one axis in a cycle."""


def values(axes: int, tracking: str) -> dict[str, object]:
    """Return the configuration of so many axes."""
    joints = dict(list(TYPICAL["joints"].items())[:axes])
    return {
        "joints": {name: {**joint, "following_error": 1.0} for name, joint in joints.items()},
        "tracking": tracking,
        "rate": 100.0,
    }


def bare(sim: RunningSim, axes: int, seconds: float) -> tuple[float, float]:
    """Return cycles a second and CPU s a cycle of a loop that does nothing but ask."""
    with serial.Serial(sim.ttys["serial"], 9600, timeout=1.0) as line:
        line.write(b"\0\rs r0x90 115200\r")  # what a break is on a pseudo-terminal
        time.sleep(0.1)
        line.baudrate = 115200
        line.reset_input_buffer()
        prefixes = [f"{node} " if node else "" for node in range(axes)]
        begun, used, cycles = time.monotonic(), time.process_time(), 0
        while time.monotonic() - begun < seconds:
            for prefix in prefixes:
                for question in QUESTIONS:
                    line.write(f"{prefix}{question}\r".encode())
                    assert line.read_until(b"\r").startswith(b"v "), "no answer"
            cycles += 1
        passed = time.monotonic() - begun
        return cycles / passed, (time.process_time() - used) / cycles


def ours(sim: RunningSim, axes: int, seconds: float) -> tuple[float, float]:
    """Return cycles a second and CPU s a cycle of the driver, enabled and at rest."""
    with arm_at(PLUGIN, sim, values(axes, "profile")) as arm:
        begun, used, samples = time.monotonic(), time.process_time(), arm.health().samples
        time.sleep(seconds)
        cycles = arm.health().samples - samples
        passed, spent = time.monotonic() - begun, time.process_time() - used
        return cycles / passed, spent / cycles


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    print("axes  bare cycles/s  cpu/cycle us  driver cycles/s  cpu/cycle us  ratio")
    for axes in (1, 3):
        with SIM.spawn(nodes=axes, line_time=True, realtime=True) as sim:
            peer = bare(sim, axes, options.seconds)
        with SIM.spawn(nodes=axes, line_time=True, realtime=True) as sim:
            own = ours(sim, axes, options.seconds)
        print(
            f"{axes:4}  {peer[0]:13.1f}  {1e6 * peer[1]:12.0f}  {own[0]:15.1f}  {1e6 * own[1]:12.0f}"
            f"  {own[0] / peer[0]:5.2f}"
        )
    print("axes  tracking  samples/s  delay ms  error p50 p99 mrad  restarts")
    for axes in (1, 3):
        for tracking in ("pvt", "profile", "stop_go"):
            with (
                SIM.spawn(nodes=axes, line_time=True, realtime=True) as sim,
                arm_at(PLUGIN, sim, values(axes, tracking)) as arm,
            ):
                samples, begun = arm.health().samples, time.monotonic()
                times, positions = follow(arm, options.seconds, SETTLED)
                rate = (arm.health().samples - samples) / (time.monotonic() - begun)
                delay, errors = judged(times, positions)
                print(
                    f"{axes:4}  {tracking:8}  {rate:9.1f}  {1e3 * delay:8.1f}  "
                    f"{1e3 * np.median(errors):9.2f} {1e3 * np.percentile(errors, 99):8.2f}"
                    f"  {arm.health().device['restarted streams']:8g}"
                )


if __name__ == "__main__":
    main()
