"""NetFT at full rate: the driver beside pynetft, alone and beside a busy Python thread in the same process.

Both run alternately against the same kind of sensor, each of whose records carries the time of its
measurement: latency is from there to a callback in Python that gets every measurement (ours in blocks,
pynetft's one by one), stamp error from there to the stamp that the client gives it. CPU is of the client's
process without the busy thread. The driver takes what has arrived once per published value; pynetft has a
thread in C++ that is woken by each datagram. Both have the interpreter's switch interval of the driver's
process.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from typing import Any

from bench.processes import ROOT, module
from bench.report import options, show

RATES = (7000.0, 7912.0)


@contextmanager
def sensor(rate: float) -> Iterator[int]:
    """Run a sensor and yield its port."""
    child = subprocess.Popen(
        [*module("bench.netft_sensor"), str(rate)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    try:
        assert child.stdout is not None
        yield int(child.stdout.readline())
    finally:
        child.kill()
        child.communicate()


def figure(
    client: str,
    rate: float,
    seconds: float,
    *,
    sensors: int = 1,
    busy: bool = False,
    publish: float = 500.0,
) -> dict[str, Any]:
    """Run one client for a while and return what it measured."""
    with ExitStack() as stack:
        ports = [str(stack.enter_context(sensor(rate))) for _ in range(sensors)]
        command = [*module("bench.netft_client"), client, str(rate), str(seconds), *ports]
        command += ["--publish", str(publish), *(["--busy"] if busy else [])]
        done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def row(name: str, found: dict[str, Any]) -> Sequence[str]:
    """Return a row of the table."""
    return (
        name,
        f"{found['received']:.0f}",
        f"{found['lost']:.0f}",
        f"{found['received'] - found['delivered']:+.0f}",
        f"{found['cpu']:.1f}",
        f"{found['latency_p50'] * 1e3:.2f}",
        f"{found['latency_p99'] * 1e3:.2f}",
        f"{found['stamp_error_p99'] * 1e6:.0f}",
    )


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "", seconds=(10.0, "in each run"), limit=(64000, "rate to go up to, in Hz")
    )
    have = find_spec("pynetft") is not None
    clients = [("ours, 500 Hz", "ours", 500.0), ("ours, 2000 Hz", "ours", 2000.0)]
    clients += [("pynetft", "pynetft", 0.0)] if have else []
    rows = []
    for rate in RATES:
        for busy in (False, True):
            for name, client, publish in clients:
                found = figure(client, rate, given.seconds, busy=busy, publish=publish or 500.0)
                rows.append(row(f"{rate:.0f} Hz{', busy' if busy else ''}: {name}", found))
    for name, client, publish in (clients[0], *clients[2:]):
        found = figure(client, 7000.0, given.seconds, sensors=3, publish=publish or 500.0)
        rows.append(row(f"3 x 7000 Hz: {name}", found))
    rate = 16000.0
    while rate <= given.limit:
        for name, client, publish in (clients[0], *clients[2:]):
            found = figure(client, rate, min(given.seconds, 5.0), publish=publish or 500.0)
            rows.append(row(f"{rate:.0f} Hz: {name}", found))
        rate *= 2.0
    columns = (
        "client",
        "received",
        "lost",
        "not delivered",
        "CPU %",
        "p50 ms",
        "p99 ms",
        "stamp p99 µs",
    )
    notes = [
        f"{given.seconds:g} s each; p50 and p99 of the latency to a callback in Python.",
        "not delivered: to the callback, of what was received in the same time.",
    ]
    if not have:
        notes.append("pynetft is not installed: pip install pynetft")
    show("NetFT stream", columns, rows, notes)


if __name__ == "__main__":
    main()
