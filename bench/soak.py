"""Commands and faults at random, by a driver at its simulator: what it survives, and what grows.

After each step the promises are checked (`bench.reliability.walk`). After each walk the driver must connect,
enable and move without faults, and one way in which it can be stopped is measured. The seed is printed;
`--seed` takes the same steps again, though never at quite the same times. Ends at the first promise that
does not hold, with the steps that led there.
"""

from __future__ import annotations

import argparse
import gc
import logging
import os
import random
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from bench.processes import usage
from bench.reliability.procedures import run
from bench.reliability.rig import BrokenPromiseError, Rig
from bench.reliability.rigs import RIGS
from bench.reliability.table import Cell, Follows
from bench.reliability.walk import Walk, walkable, wander
from bench.report import show, spread
from crtk_drivers.errors import CrtkError

STEPS = 60
"""Between two looks at what has grown; each walk begins and ends at rest."""
MEGABYTE = 1e6


class Growth:
    """Memory, threads and descriptors of this process and its simulator, over time."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, float, int, int, float]] = []
        self._began = time.monotonic()

    def look(self, rig: Rig) -> None:
        """Note what there is now."""
        gc.collect()
        mine = usage(os.getpid()).rss / MEGABYTE
        theirs = usage(rig.sim.pid).rss / MEGABYTE if rig.sim is not None else 0.0
        descriptors = len(list(Path("/proc/self/fd").iterdir()))
        elapsed = time.monotonic() - self._began
        self.rows.append((elapsed, mine, threading.active_count(), descriptors, theirs))

    def table(self) -> list[list[str]]:
        """Return the first, the middle and the last look, and the slope after the first third."""
        kept = [self.rows[0], self.rows[len(self.rows) // 2], self.rows[-1]]
        shown = [
            [f"{at / 60.0:.1f} min", f"{mine:.1f}", str(threads), str(fds), f"{theirs:.1f}"]
            for at, mine, threads, fds, theirs in kept
        ]
        warm = self.rows[len(self.rows) // 3]
        last = self.rows[-1]
        hours = max((last[0] - warm[0]) / 3600.0, 1e-9)
        grown = [f"{(last[i] - warm[i]) / hours:+.1f}" for i in (1, 2, 3, 4)]
        return [*shown, ["an hour", *grown]]


def stop_times(rig: Rig, generator: random.Random, times: list[float], ways: list[float]) -> None:
    """Measure one way of stopping, at random: a fault that stops it, or a stream that ends."""
    stopping = [
        way
        for way in type(rig).ways
        if way.follows in (Follows.STOPS, Follows.HOLDS) and not way.pending and not way.freezes
    ]
    way = generator.choice(stopping)
    activities = [a for a in (way.activities or rig.activities) if a in rig.activities]
    result = run(rig, Cell(rig.name, way, generator.choice(activities)))
    if result.stood is not None and rig.moves_joints:
        # From when it was told on: until then the fault was not known.
        times.append(max(0.0, result.stood - (result.told or 0.0)))
        ways.append(result.way or 0.0)


def soak(name: str, minutes: float, seed: int) -> int:
    """Go on with one driver; print what came of it, and return how many promises were broken."""
    generator = random.Random(f"{seed} {name}")
    growth = Growth()
    counts: Counter[str] = Counter()
    times: list[float] = []
    ways: list[float] = []
    broken = 0
    with RIGS[name]() as rig:
        policy = rig.engine.capabilities.stop
        end = time.monotonic() + 60.0 * minutes
        while time.monotonic() < end and not broken:
            walk = Walk(rig)
            try:
                walk.recovers()
                growth.look(rig)
                for _ in range(STEPS):
                    wander(walk, generator)
                walk.recovers()
                stop_times(rig, generator, times, ways)
            except (BrokenPromiseError, CrtkError) as error:
                broken += 1
                told = error if isinstance(error, BrokenPromiseError) else walk.broken(str(error))
                print(f"{name}, seed {seed}: {told}", flush=True)
            counts += walk.story.counts
        growth.look(rig)
        _print(name, seed, counts, growth, broken, times, ways, policy.time + policy.link_timeout)
    return broken


def _print(
    name: str,
    seed: int,
    counts: Counter[str],
    growth: Growth,
    broken: int,
    times: Sequence[float],
    ways: Sequence[float],
    declared: float,
) -> None:
    head = ("at", "driver MB", "threads", "descriptors", "simulator MB")
    stops = ", ".join(spread(times, 1000.0))
    show(
        f"{name}: {growth.rows[-1][0] / 60.0:.1f} min, seed {seed}",
        head,
        growth.table(),
        [
            f"faults survived: {counts['fault']}, restarts: {counts['restart']}, "
            f"steps: {sum(counts.values())}, promises broken: {broken}",
            f"{len(times)} stops, after they were told, ms p50, p99, max: {stops}; "
            f"declared: {1000.0 * declared:.0f}",
            f"way from the fault until they stood, p50, p99, max: {', '.join(spread(ways, 1.0, 3))}",
        ],
    )


def main() -> int:
    """Soak each driver in turn; 1 if a promise was broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=60.0, help="for each driver (default: 60)")
    parser.add_argument("--driver", action="append", choices=list(RIGS), help="only this one")
    parser.add_argument("--seed", type=int, default=None, help="of an earlier run")
    given = parser.parse_args()
    seed = random.SystemRandom().randrange(10**9) if given.seed is None else given.seed
    logging.disable(logging.CRITICAL)
    print(f"seed {seed}", flush=True)
    names = [name for name in given.driver or RIGS if walkable(RIGS[name])]
    return 1 if sum(soak(name, given.minutes, seed) for name in names) else 0


if __name__ == "__main__":
    sys.exit(main())
