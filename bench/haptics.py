"""The local force loop: what a step costs, how even a loop at 1 and 4 kHz is, how stiff a wall stays passive.

A step is that of four fixtures, one of them touched. The loop sleeps between its steps, as a driver's process
does; lateness is against an even clock. How stiff a wall may be before it gives a mass energy is found by
halving, against the delay of its forces; beside it what a wall of three times that gives, with the tank and
without.

    python -m bench.haptics --seconds 5
"""

from __future__ import annotations

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from bench import report
from crtk_drivers.kit.haptics import (
    Box,
    Fixture,
    ForceLimits,
    ForceLoop,
    Motion,
    Sphere,
    Spring,
    TankLimits,
    Wall,
)
from crtk_drivers.kit.haptics.fixtures import MOST_STIFFNESS
from crtk_drivers.status.real_time import ask_for_real_time

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rigs.simulated_hand import Hand, driven

LIMITS = ForceLimits(force=10.0, ramp=0.02)
FIXTURES: dict[str, Fixture] = {
    "floor": Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 800.0, 3.0),
    "cage": Box((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1), 500.0, 3.0),
    "ball": Sphere((0.0, 0.0, 0.2), 0.05, 500.0, 3.0, "outside"),
    "there": Spring((0.0, 0.0, 0.0), stiffness=50.0, damping=1.0),
}
DAMPING = 2.0
PRESSED = 1.5
AMPLE = 1e5
NOTHING = 1e-4
"""J: below that a wall gives nothing."""


def paced(rate: float, seconds: float) -> tuple[list[float], list[float], float]:
    """Run a loop; return lateness and cost of each step in s, and the CPU as a share of a core."""
    ask_for_real_time(10)
    loop = ForceLoop(LIMITS, TankLimits(period=1.0 / rate))
    loop.use(FIXTURES)
    late, cost = [], []
    cpu, begin = time.process_time(), time.monotonic()
    loop.enable(begin)
    for index in range(round(seconds * rate)):
        due = begin + index / rate
        now = time.monotonic()
        if now < due:
            time.sleep(due - now)
            now = time.monotonic()
        depth = 0.002 * np.sin(6.0 * now)
        loop.step(Motion((0.0, 0.0, float(depth)), velocity=(0.0, 0.0, 0.01)), now)
        cost.append(time.monotonic() - now)
        late.append(now - due)
    return late, cost, (time.process_time() - cpu) / (time.monotonic() - begin)


def given(stiffness: float, rate: float, delay: int, allowance: float) -> float:
    """Return the most J that a wall gave a mass which was pushed on it for `PRESSED` seconds."""
    tank = TankLimits(allowance=allowance, acceleration=100.0, delay=delay, period=1.0 / rate)
    loop = ForceLoop(LIMITS, tank)
    loop.use({"floor": Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), stiffness, DAMPING)})
    loop.enable(0.0)
    hand = Hand(0.2, position=(0.0, 0.0, 0.005))
    pushes = [(0.0, 0.0, -3.0)] * round(PRESSED * rate)
    return max(hand.given for _ in driven(hand, loop, pushes, period=1.0 / rate, delay=delay))


def stiffest(rate: float, delay: int) -> float:
    """Return the stiffness in N/m up to which a wall by itself, without the tank, gives nothing."""
    low, high = 10.0, MOST_STIFFNESS
    while high / low > 1.05:
        middle = (low * high) ** 0.5
        if given(middle, rate, delay, AMPLE) > NOTHING:
            high = middle
        else:
            low = middle
    return low


def main() -> None:
    """Measure and print."""
    options = report.options(__doc__ or "", seconds=(5.0, "of each rate"))
    rows = []
    for rate in (1000.0, 4000.0):
        with ThreadPoolExecutor(1) as thread:  # whose priority ends with it
            late, cost, cpu = thread.submit(paced, rate, options.seconds).result()
        rows.append(
            [
                f"{rate:.0f} Hz",
                *report.spread(cost, 1e6, 1),
                *report.spread(late, 1e6),
                f"{100 * cpu:.0f}",
            ]
        )
    columns = ("loop", "step p50 µs", "p99", "max", "late p50 µs", "p99", "max", "CPU %")
    report.show("Local force loop, four fixtures", columns, rows)
    rows = []
    for rate in (1000.0, 4000.0):
        for delay in (0, 1, 2, 4):
            limit = stiffest(rate, delay)
            beyond = min(3.0 * limit, MOST_STIFFNESS)
            with_tank, without = (given(beyond, rate, delay, most) for most in (0.01, AMPLE))
            figures = (limit, beyond, 1e3 * with_tank, 1e3 * without)
            rows.append([f"{rate:.0f} Hz, {delay} cycles", *(f"{each:.0f}" for each in figures)])
    columns = ("rate, delay of forces", "passive to N/m", "at N/m", "mJ given", "without the tank")
    notes = [
        f"wall with {DAMPING:g} N s/m; 0.2 kg without friction, pushed with 3 N for {PRESSED:g} s; "
        "allowance 10 mJ, and 10 mW."
    ]
    report.show("How stiff a wall may be", columns, rows, notes)


if __name__ == "__main__":
    main()
