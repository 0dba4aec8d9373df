"""A simulated SCHUNK FTS at its driver: measurements, loss, and CPU of the driver's process.

python -m bench.fts_stream --seconds 20
"""

from __future__ import annotations

import sys
import time
from typing import Any

import crtk_drivers
from bench.report import options, show

RATES = (100.0, 500.0, 1000.0)
"""At which the driver publishes, in Hz."""


def measure(rate: float, seconds: float) -> list[str]:
    """Return a row."""
    sensor: Any
    with crtk_drivers.connect(
        "schunk-fts", sim=True, rate=rate, sim_options={"tcp_port": 0}
    ) as sensor:
        sensor.enable()
        time.sleep(1.0)
        before, samples, cpu = sensor.health().device, sensor.health().samples, time.process_time()
        time.sleep(seconds)
        after, told = sensor.health().device, sensor.health().samples
        share = (time.process_time() - cpu) / seconds
    received = after["received"] - before["received"]
    return [
        f"{rate:.0f}",
        f"{received / seconds:.0f}",
        f"{(told - samples) / seconds:.0f}",
        f"{after['lost'] - before['lost']:.0f}",
        f"{100.0 * share:.1f}",
    ]


def main() -> int:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(20.0, "of each"))
    rows = [measure(rate, given.seconds) for rate in RATES]
    columns = ("rate", "measurements/s", "samples/s", "lost", "CPU %")
    show("A simulated FTS", columns, rows, [])
    return 0


if __name__ == "__main__":
    sys.exit(main())
