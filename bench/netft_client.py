"""One client of `bench.netft_sensor`, in a process of its own: ours or pynetft. Prints a figure as JSON."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bench.interpreter import SWITCH_INTERVAL, busy_thread

SETTLE = 1.5
"""Seconds that are not counted."""


class Figures:
    """What is measured of one client, from the moment it has settled."""

    def __init__(self) -> None:
        self.counting = False
        self.latencies: list[Any] = []
        self.errors: list[Any] = []

    def take(self, measured: Any, delivered: Any, stamped: Any) -> None:
        """Add values, all in monotonic seconds."""
        if self.counting:
            self.latencies.append(delivered - measured)
            self.errors.append(stamped - measured)


def thread_times() -> dict[int, float]:
    """Return the CPU time of each thread of this process, in s."""
    times = {}
    for task in Path("/proc/self/task").iterdir():
        fields = (task / "schedstat").read_text().split()
        times[int(task.name)] = int(fields[0]) * 1e-9
    return times


@contextmanager
def ours(ports: list[int], rate: float, publish: float, figures: Figures) -> Iterator[Any]:
    """Run our driver, in the runtime of the core, without ROS."""
    from crtk_driver_ati_netft import PLUGIN
    from crtk_drivers.config import from_values, load
    from crtk_drivers.engine import Engine
    from crtk_drivers.engine.threads import Runtime

    engines = []
    for port in ports:
        values = {
            "host": "127.0.0.1",
            "rdt_port": port,
            "http": False,
            "transport": "udp",
            "profile": "axia" if rate > 7500.0 else "netbox",
            "rate": publish,
            "scale": {"counts_per_force": 1, "counts_per_torque": 1},
        }
        device: Any = PLUGIN.create(load(PLUGIN.config, from_values(values)))

        def take(block: Any) -> None:
            now = time.monotonic()
            wall = time.time_ns() - round(now * 1e9)
            measured = block["raw"][:, 0] + block["raw"][:, 1] * 1e-9
            figures.take(measured, now, (block["stamp"] - wall) * 1e-9)

        device.add_listener(take)
        engines.append(Engine(device, f"sensor {port}"))
    runtime = Runtime([(engine, 5.0) for engine in engines])
    runtime.start()
    try:
        yield lambda: (
            sum(engine.device.counters.get("received", 0.0) for engine in engines),
            sum(engine.device.counters.get("lost", 0.0) for engine in engines),
        )
    finally:
        runtime.close()


@contextmanager
def pynetft(ports: list[int], rate: float, publish: float, figures: Figures) -> Iterator[Any]:
    """Run pynetft, delivering every sample to a callback in Python; `publish` means nothing to it."""
    import pynetft as library

    scale = library.Calibration(1.0, 1.0, library.ForceUnit.NEWTON, library.TorqueUnit.NEWTON_METER)
    clients = []

    def take(sample: Any) -> None:
        now = time.monotonic()
        measured = sample.raw_wrench[0] + sample.raw_wrench[1] * 1e-9
        figures.take(measured, now, sample.received_at_ns * 1e-9)

    for port in ports:
        config = library.Config(sensor_host="127.0.0.1", rdt_port=port, calibration_override=scale)
        clients.append(library.Client(config, queue_size=100_000))
    for client in clients:
        client.start(take)
    try:
        yield lambda: (
            sum(client.health().received_count for client in clients),
            sum(client.health().lost_count for client in clients),
        )
    finally:
        for client in clients:
            client.stop()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("client", choices=("ours", "pynetft"))
    parser.add_argument("rate", type=float)
    parser.add_argument("seconds", type=float)
    parser.add_argument("--publish", type=float, default=500.0)
    parser.add_argument("--busy", action="store_true")
    parser.add_argument("ports", type=int, nargs="+")
    given = parser.parse_args()
    sys.setswitchinterval(SWITCH_INTERVAL)
    figures = Figures()
    make = {"ours": ours, "pynetft": pynetft}[given.client]
    with (
        make(given.ports, given.rate, given.publish, figures) as counts,
        busy_thread(given.busy) as busy,
    ):
        time.sleep(SETTLE)
        received, lost = counts()
        before, begin = thread_times(), time.monotonic()
        figures.counting = True
        time.sleep(given.seconds)
        figures.counting = False
        after, elapsed = thread_times(), time.monotonic() - begin
        total = [end - start for end, start in zip(counts(), (received, lost), strict=True)]
    spent = sum(t - before.get(i, 0.0) for i, t in after.items() if i != busy)
    latencies = np.concatenate([np.atleast_1d(some) for some in figures.latencies] or [np.zeros(1)])
    errors = np.abs(
        np.concatenate([np.atleast_1d(some) for some in figures.errors] or [np.zeros(1)])
    )
    p50, p99 = np.percentile(latencies, (50, 99)).tolist()
    print(
        json.dumps(
            {
                "received": total[0],
                "lost": total[1],
                "delivered": int(latencies.size),
                "cpu": 100.0 * spent / elapsed,
                "latency_p50": p50,
                "latency_p99": p99,
                "stamp_error_p99": float(np.percentile(errors, 99)),
            }
        )
    )


if __name__ == "__main__":
    main()
