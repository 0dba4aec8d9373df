"""How a Galil controller follows servo_jp: a sine of 1 Hz by PVT, by PT, and from rest to rest.

The simulated controller, its motors 4 ms behind their profiles; the stream of setpoints at 250 Hz. Delay is
what the measured positions are best shifted by; error is what is left then. Beside it the time from a step of
servo_jp to the first data record in which the joint has moved, and what a cycle costs.

    python -m bench.galil_tracking
"""

from __future__ import annotations

import argparse
import math
import statistics
import time

import numpy as np

from bench.motor_arm import arm_at
from crtk_driver_galil import PLUGIN
from crtk_driver_galil.plugin import TYPICAL
from crtk_drivers.engine.intake import Moment
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import JointState
from crtk_sim_backends.galil import SIM

AMPLITUDE = 0.2
RATE = 250.0
FREQUENCY = 1.0
SETTLED = 1.0
STEP = 0.01
MOVED = 1.5 * 2.0 * math.pi / 100_000


def values(tracking: str) -> dict[str, object]:
    """Return the configuration."""
    joints = {name: {**joint, "following_error": 1.0} for name, joint in TYPICAL["joints"].items()}
    return {"joints": joints, "tracking": tracking}


class Watch:
    """Notes when each sample was taken and where a joint was, in the thread that reads them, until `end`."""

    def __init__(self, arm: LocalDevice, joint: int) -> None:
        self.told: list[tuple[float, float]] = []
        self._engine, self._joint = arm.engine, joint
        self._engine.keepers = (*self._engine.keepers, self._note)

    def _note(self, moment: Moment) -> None:
        sample = moment[1]
        state = sample.values["measured_js"]
        assert isinstance(state, JointState)
        self.told.append((sample.stamp.monotonic, float(state.position[self._joint])))

    def end(self) -> None:
        """Note no more."""
        self._engine.keepers = ()


def follow(
    arm: LocalDevice, seconds: float, settled: float = SETTLED
) -> tuple[np.ndarray, np.ndarray]:
    """Stream the sine; return times and positions (n,) of the first joint, from where it began.

    Args:
        arm: enabled.
        seconds: how long.
        settled: seconds from which on it is looked at.
    """
    start = arm.measured_js().position
    watch = Watch(arm, 0)
    begun = time.monotonic()
    while (passed := time.monotonic() - begun) < seconds:
        goal = start.copy()
        goal[0] += AMPLITUDE * math.sin(2.0 * math.pi * FREQUENCY * passed) * min(1.0, passed)
        arm.servo_jp(goal)
        time.sleep(max(0.0, begun + math.ceil((passed + 1e-6) * RATE) / RATE - time.monotonic()))
    watch.end()
    times, positions = np.array(watch.told).T
    kept = times - begun > settled
    return times[kept] - begun, positions[kept] - start[0]


def judged(times: np.ndarray, positions: np.ndarray) -> tuple[float, np.ndarray]:
    """Return delay in s, and the errors (n,) in rad that are left with it."""

    def left(delay: float) -> np.ndarray:
        return positions - AMPLITUDE * np.sin(2.0 * np.pi * FREQUENCY * (times - delay))

    delays = np.arange(0.0, 0.6, 0.0005)
    best = float(delays[int(np.argmin([np.median(np.abs(left(delay))) for delay in delays]))])
    return best, np.abs(left(best))


def latencies(arm: LocalDevice, count: int) -> list[float]:
    """Return the seconds from servo_jp to the record that shows that the joint moves."""
    found = []
    watch = Watch(arm, 1)
    for number in range(count):
        time.sleep(0.3)
        goal = arm.measured_js().position.copy()
        here = goal[1]
        goal[1] += STEP if number % 2 else -STEP
        watch.told.clear()
        begun = time.monotonic()
        while time.monotonic() - begun < 0.3:
            arm.servo_jp(goal)
            time.sleep(0.004)
        moved = [
            at for at, position in list(watch.told) if at > begun and abs(position - here) > MOVED
        ]
        found.append(moved[0] - begun if moved else math.nan)
    watch.end()
    return sorted(found)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--steps", type=int, default=40)
    options = parser.parse_args()
    print("tracking  records/s  cpu/cycle us  latency p50 p99 ms  delay ms  error p50 p99 mrad")
    for tracking in ("pvt", "pt", "stop_go"):
        with SIM.spawn(realtime=True) as sim, arm_at(PLUGIN, sim, values(tracking)) as arm:
            before, began, used = arm.health().samples, time.monotonic(), time.process_time()
            times, positions = follow(arm, options.seconds)
            passed, spent = time.monotonic() - began, time.process_time() - used
            samples = arm.health().samples - before
            delay, errors = judged(times, positions)
            steps = latencies(arm, options.steps)
            p99 = steps[min(len(steps) - 1, int(0.99 * len(steps)))]
            counters = arm.engine.device.counters
            print(
                f"{tracking:8}  {samples / passed:9.1f}  {1e6 * spent / samples:12.0f}  "
                f"{1e3 * statistics.median(steps):11.1f} {1e3 * p99:5.1f}  {1e3 * delay:8.1f}  "
                f"{1e3 * np.median(errors):9.2f} {1e3 * np.percentile(errors, 99):8.2f}"
                f"  restarts {counters['restarted streams']:g}"
            )


if __name__ == "__main__":
    main()
