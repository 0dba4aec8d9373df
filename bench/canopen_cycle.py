"""The cycle of a CANopen arm: the driver beside the canopen library's own PDO path, in turn, on one bus.

Each cycle is SYNC, a TPDO of 6 bytes from every drive, and an RPDO of 6 bytes to each, over the virtual bus
without a bit rate. The drives are in a process of their own: first such that take no time to answer, so that
only client and bus count, then simulated ones, which reckon on the same cores. Every cycle wakes that process
and is woken by it, which takes long where idle cores sleep, above all in a virtual machine; so the same is
measured with cores kept awake, as on a computer that is set up for control.

CPU is of the client's process with all its threads: its own, and the kernel's for it, which is that of 13
frames and of waking the drives. "with 402" steps a power state machine for each axis as well. The
interpreter's switch interval is that of the driver's process for all.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from statistics import median
from typing import Any

from bench.awake import awake
from bench.canopen_answers import answers
from bench.processes import ROOT, module
from bench.report import options, ratio, show
from bench.wake_up import round_trip
from crtk_sim_backends.canopen import SIM
from crtk_sim_backends.canopen.eds import PUBLISHED

CLIENTS = {"library": "canopen library", "ours": "driver", "machines": "driver with 402"}
RATES = (250.0, 500.0, 1000.0)

Drives = Callable[[int], AbstractContextManager[str]]
"""Runs so many drives, and tells the path of their bus."""


def figure(client: str, channel: str, nodes: int, seconds: float, *more: str) -> dict[str, Any]:
    """Run one client for a while and return what it measured."""
    command = [*module("bench.canopen_client"), client, channel, str(PUBLISHED)]
    command += [str(nodes), str(seconds), *more]
    done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def unpaced_rows(
    drives: Drives, label: str, nodes: int, seconds: float, rounds: int
) -> Iterator[tuple[str, ...]]:
    """Yield how fast cycles follow each other, a row for each client."""
    found: dict[str, list[dict[str, Any]]] = {client: [] for client in CLIENTS}
    for _ in range(rounds):
        for client, runs in found.items():
            with drives(nodes) as channel:
                runs.append(figure(client, channel, nodes, seconds))
    middle = {
        client: {key: median(each[key] for each in runs) for key in runs[0]}
        for client, runs in found.items()
    }
    base = middle["library"]
    for client, each in middle.items():
        yield (
            f"{label}: {CLIENTS[client]}",
            f"{each['rate']:.0f}",
            ratio(each["rate"], base["rate"]),
            f"{each['user'] * 1e6:.0f}",
            ratio(base["user"], each["user"]),
            f"{each['kernel'] * 1e6:.0f}",
            f"{each['p50'] * 1e6:.0f}",
            f"{each['p99'] * 1e6:.0f}",
            f"{each['missed']:.0f}",
        )


@contextmanager
def simulated(nodes: int) -> Iterator[str]:
    """Run simulated drives and yield the path of their bus."""
    with SIM.spawn(nodes=nodes) as sim:
        yield sim.paths["crtk"]


def show_unpaced(nodes: int, seconds: float, rounds: int, condition: str) -> None:
    """Print how fast cycles follow each other."""
    kinds: tuple[tuple[Drives, str], ...] = ((answers, "at once"), (simulated, "simulated"))
    rows = [
        row
        for drives, label in kinds
        for row in unpaced_rows(drives, label, nodes, seconds, rounds)
    ]
    show(
        f"{nodes} drives, cycles one after the other{condition}",
        (
            "drives: client",
            "cycles/s",
            "times",
            "own µs",
            "less by",
            "kernel µs",
            "p50 µs",
            "p99 µs",
            "missed",
        ),
        rows,
        [
            f"medians of {rounds} runs of {seconds:g} s each, the clients in turn. A packet to another "
            f"core and back, without any work: {round_trip() * 1e6:.0f} µs."
        ],
    )


def show_paced(channel: str, nodes: int, seconds: float, *, busy: bool) -> None:
    """Print how punctual cycles are at fixed rates."""
    rows = []
    for rate in RATES:
        for client, name in CLIENTS.items():
            more = ["--rate", str(rate), *(["--busy"] if busy else [])]
            found = figure(client, channel, nodes, seconds, *more)
            times = [f"{found[key] * 1e6:.0f}" for key in ("p50", "p99", "max")]
            overruns = f"{found['overruns']}/{found['cycles']}"
            rows.append(
                (f"{rate:.0f} Hz {name}", *times, overruns, f"{100.0 * found['cpu']:.0f} %")
            )
    show(
        f"{nodes} drives at fixed rates" + (", beside a busy Python thread" if busy else ""),
        ("client", "start late p50 µs", "p99 µs", "max µs", "overruns", "CPU"),
        rows,
        [f"{seconds:g} s each." + (" CPU is with that of the busy thread." if busy else "")],
    )


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "",
        drives=(6, "number of drives"),
        seconds=(2.0, "length of each run"),
        rounds=(3, "runs of each client one after the other"),
    )
    for nodes in (given.drives, 2 * given.drives):
        show_unpaced(nodes, given.seconds, given.rounds, "")
        try:
            with awake():
                show_unpaced(nodes, given.seconds, given.rounds, ", cores kept awake")
        except PermissionError as error:
            print(f"\nnot measured with cores kept awake, which takes root: {error}")
    with simulated(given.drives) as channel:
        show_paced(channel, given.drives, given.seconds, busy=False)
        show_paced(channel, given.drives, given.seconds, busy=True)


if __name__ == "__main__":
    main()
