"""The cycle of a CANopen arm: the driver beside the canopen library's own PDO path, in turn, on one bus.

Each cycle is SYNC, a TPDO of 6 bytes from every drive, and an RPDO of 6 bytes to each, over the virtual bus
without a bit rate, so that only the programs count. The drives are simulated in a process of their own.
CPU is of the client's process with all its threads: its own, and the kernel's for
it, which is that of 13 frames and of waking the drives. "with 402" steps a power state machine for each axis
as well. The interpreter's switch interval is that of the driver's process for all.
"""

from __future__ import annotations

import json
import subprocess
from statistics import median
from typing import Any

from bench.processes import ROOT, module
from bench.report import options, ratio, show
from crtk_sim_backends.canopen import SIM
from crtk_sim_backends.process import RunningSim

CLIENTS = {"library": "canopen library", "ours": "driver", "machines": "driver with 402"}
RATES = (250.0, 500.0, 1000.0)


def figure(sim: RunningSim, client: str, nodes: int, seconds: float, *more: str) -> dict[str, Any]:
    """Run one client for a while and return what it measured."""
    command = [*module("bench.canopen_client"), client, sim.paths["crtk"], sim.paths["eds"]]
    command += [str(nodes), str(seconds), *more]
    done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def show_unpaced(sim: RunningSim, nodes: int, seconds: float, rounds: int) -> None:
    """Print how fast cycles follow each other."""
    found: dict[str, list[dict[str, Any]]] = {client: [] for client in CLIENTS}
    for _ in range(rounds):
        for client in CLIENTS:
            found[client].append(figure(sim, client, nodes, seconds))
    middle = {
        client: {key: median(each[key] for each in runs) for key in runs[0]}
        for client, runs in found.items()
    }
    base = middle["library"]
    rows = [
        (
            CLIENTS[client],
            f"{each['rate']:.0f}",
            ratio(each["rate"], base["rate"]),
            f"{each['user'] * 1e6:.0f}",
            ratio(base["user"], each["user"]),
            f"{each['kernel'] * 1e6:.0f}",
            f"{each['p50'] * 1e6:.0f}",
            f"{each['p99'] * 1e6:.0f}",
            f"{each['missed']:.0f}",
        )
        for client, each in middle.items()
    ]
    show(
        f"{nodes} drives, cycles one after the other",
        (
            "client",
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
        [f"medians of {rounds} runs of {seconds:g} s each, the clients in turn."],
    )


def show_paced(sim: RunningSim, nodes: int, seconds: float, *, busy: bool) -> None:
    """Print how punctual cycles are at fixed rates."""
    rows = []
    for rate in RATES:
        for client, name in CLIENTS.items():
            more = ["--rate", str(rate), *(["--busy"] if busy else [])]
            found = figure(sim, client, nodes, seconds, *more)
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
        seconds=(3.0, "length of each run"),
        rounds=(3, "runs of each client one after the other"),
    )
    for drives in (given.drives, 2 * given.drives):
        with SIM.spawn(nodes=drives) as sim:
            show_unpaced(sim, drives, given.seconds, given.rounds)
    with SIM.spawn(nodes=given.drives) as sim:
        show_paced(sim, given.drives, given.seconds, busy=False)
        show_paced(sim, given.drives, given.seconds, busy=True)


if __name__ == "__main__":
    main()
