"""How fast a world runs: virtual seconds of each device by CPU second, the start of a host, and a switch.

Devices move to and fro for 20 virtual seconds; sensors stream. The scenarios are those of tests/world.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from bench.report import options, show
from crtk_drivers.testing.world import Host

if TYPE_CHECKING:
    from crtk_drivers.testing.world import World

SCENARIOS: Final = Path(__file__).parents[1] / "tests" / "world" / "plain_worlds.py"
DEVICES: Final = (
    "robotiq_ft300",
    "weiss_wsg",
    "schunk",
    "robotiq_tcp",
    "optoforce",
    "onrobot",
    "robotiq_serial",
    "robotiq_epick",
    "raven",
    "ndi",
    "inputs",
    "dvrk",
    "galil",
    "ati_netft",
    "schunk_fts",
    "dynamixel",
    "copley",
    "haply",
    "ur",
    "canopen",
)
HORIZON: Final = 1000.0
SLEEPS: Final = 10_000


def switches(_: World) -> None:
    """Be the scenario of two threads that only sleep."""

    def sleep() -> None:
        for _ in range(SLEEPS):
            time.sleep(0.001)

    threads = [threading.Thread(target=sleep) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def switch_time(seed: int) -> float:
    """Return the seconds of CPU of a switch from one thread to another."""
    with Host(Path(__file__)) as host:
        outcome = host.run("switches", seed, horizon=HORIZON)
    outcome.check()
    return outcome.cpu / outcome.switches


def main() -> None:
    """Measure and print."""
    seed = int(options(__doc__ or "", seed=(1, "of each world")).seed)
    rows = []
    began = time.monotonic()
    with Host(SCENARIOS) as host:
        host.run("visits.inputs", seed).check()
        start = time.monotonic() - began
        for name in DEVICES:
            short = host.run(f"visits.{name}", seed)
            outcome = host.run(f"long_visits.{name}", seed, horizon=HORIZON)
            outcome.check()
            row = outcome.virtual / outcome.cpu, outcome.switches / outcome.virtual, short.cpu
            rows.append(
                [
                    name,
                    *(f"{value:.{digits}f}" for value, digits in zip(row, (1, 0, 2), strict=True)),
                ]
            )
    show(
        "Worlds",
        ("device", "virtual s by CPU s", "switches by virtual s", "CPU s of a test's world"),
        rows,
        [
            f"{start:.1f} s until the first world of a host has run; "
            f"{1e6 * switch_time(seed):.1f} µs of CPU a switch of threads."
        ],
    )


if __name__ == "__main__":
    main()
