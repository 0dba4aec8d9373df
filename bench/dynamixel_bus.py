"""A DYNAMIXEL chain as fast as the wire allows: our transactions beside dynamixel-sdk.

Both run alternately, each in a process of its own, on the same simulated bus, where bytes take the time that
they take on a wire; return delay is 0. Each cycle reads current, velocity and position of every servo (10
bytes) with one sync read or fast sync read, and writes a goal position to each with one sync write. The wire
limit is what these bytes take at the baud rate. CPU is of the thread that runs the bus.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from bench.processes import ROOT, module
from bench.report import options, show
from crtk_sim_backends.dynamixel import SIM
from crtk_sim_backends.process import RunningSim

BAUDS = (1_000_000, 3_000_000, 4_000_000)
CLIENTS = (("ours", "ours"), ("dynamixel-sdk", "sdk"))
COLUMNS = ("client", "cycles/s", "of wire", "CPU µs", "CPU %", "p50 ms", "p99 ms", "missing %")
MODEL = "xm430-w350"


@contextmanager
def chain(baud: int, count: int) -> Iterator[tuple[RunningSim, str]]:
    """Run simulated servos, and yield the simulator and its port."""
    servos = ",".join(f"{id}:{MODEL}" for id in range(1, count + 1))
    with SIM.spawn(servos=servos, baud=baud, return_delay=0) as sim:
        yield sim, next(iter(sim.ttys.values()))


def wire_time(baud: int, count: int, *, fast: bool) -> float:
    """Return the seconds that the bytes of one cycle take (e-manual, protocol 2.0)."""
    request, write = 14 + count, 14 + 5 * count
    replies = 8 + 14 * count if fast else 21 * count
    return (request + replies + write) * 10 / baud


def figure(
    client: str, port: str, baud: int, count: int, seconds: float, *flags: str
) -> dict[str, Any]:
    """Run one client for a while and return what it measured."""
    command = [*module("bench.dynamixel_client"), client, port, str(baud), str(count), str(seconds)]
    done = subprocess.run(
        [*command, *flags], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def row(name: str, found: dict[str, Any], wire: float) -> Sequence[str]:
    """Return a row of the table."""
    return (
        name,
        f"{found['rate']:.0f}",
        f"{100 * found['rate'] * wire:.0f} %",
        f"{found['cpu'] * 1e6:.0f}",
        f"{found['load'] * 100:.1f}",
        f"{found['p50'] * 1e3:.2f}",
        f"{found['p99'] * 1e3:.2f}",
        f"{found['missing'] * 100:.2f}",
    )


def both(
    title: str, port: str, baud: int, count: int, seconds: float, *flags: str
) -> Iterator[Sequence[str]]:
    """Yield the rows of both clients, with sync reads and with fast ones."""
    for fast in (False, True):
        wire = wire_time(baud, count, fast=fast)
        for name, client in CLIENTS:
            given = (*flags, "--fast") if fast else flags
            found = figure(client, port, baud, count, seconds, *given)
            yield row(f"{title}, {'fast' if fast else 'sync'}: {name}", found, wire)


def rates(seconds: float, count: int) -> None:
    """Show what is reached at each baud rate."""
    rows: list[Sequence[str]] = []
    for baud in BAUDS:
        with chain(baud, count) as (_, port):
            rows += both(f"{baud // 1_000_000} Mbps", port, baud, count, seconds)
    show(f"DYNAMIXEL bus, {count} servos", COLUMNS, rows)


def sizes(seconds: float, baud: int) -> None:
    """Show that the cost grows linearly with the servos."""
    rows: list[Sequence[str]] = []
    costs = []
    for count in (6, 12, 24):
        with chain(baud, count) as (_, port):
            rows += both(f"{count} servos", port, baud, count, seconds)
        costs.append((count, float(rows[-4][3])))
    (few, low), _, (many, high) = costs
    slope = (high - low) / (many - few)
    line = f"ours, sync: {low - few * slope:.0f} µs + {slope:.1f} µs a servo."
    show(f"DYNAMIXEL chains at {baud // 1_000_000} Mbps", COLUMNS, rows, [line])


def troubles(seconds: float, baud: int, count: int) -> None:
    """Show what a silent servo costs the others, and what a busy thread does."""
    rows: list[Sequence[str]] = []
    with chain(baud, count) as (sim, port):
        rows += both("beside a busy thread", port, baud, count, seconds, "--busy")
        for behaviour in ("stalls", "goes_on"):
            sim.control.inject("silent", id=count // 2, chain=behaviour)
            words = "behind it silent too" if behaviour == "stalls" else "behind it go on"
            rows += both(f"one silent, {words}", port, baud, count, seconds)
            sim.control.clear("silent")
    notes = ["missing: values of servos, of those asked for; one silent of 6 is 16.67 %."]
    show(
        f"DYNAMIXEL bus in trouble, {count} servos, {baud // 1_000_000} Mbps", COLUMNS, rows, notes
    )


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(3.0, "in each run"), count=(6, "servos"))
    rates(given.seconds, given.count)
    sizes(given.seconds, 4_000_000)
    troubles(given.seconds, 1_000_000, given.count)


if __name__ == "__main__":
    main()
