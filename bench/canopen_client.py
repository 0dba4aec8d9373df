"""One client of `bench.canopen_cycle`, in a process of its own: ours or the canopen library. Prints JSON."""

from __future__ import annotations

import argparse
import gc
import json
import logging
import resource
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import canopen
import numpy as np

from bench.interpreter import SWITCH_INTERVAL, busy_thread
from crtk_driver_canopen.bus import CanLink
from crtk_driver_canopen.commissioning import prepare
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.cycle import Cycle, SentSync
from crtk_driver_canopen.heartbeat import NmtCommand
from crtk_driver_canopen.layout import plan
from crtk_driver_canopen.master import Master
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.statemachine import Drive402
from crtk_driver_canopen.tools import bus_address
from crtk_drivers.config import from_values, load

SETTLE = 100
"""Cycles that are not counted."""
PATIENCE = 0.1
"""Seconds that are waited for the drives' answers, at most."""

Step = Callable[[], bool]
"""One cycle; returns whether every drive answered."""


def configuration(channel: str, nodes: int) -> CanopenConfig:
    """Return an arm with one PDO of 6 bytes each way and axis, which nothing but PDOs disturbs."""
    limits = {"lower": -6.0, "upper": 6.0, "velocity": 5.0, "abort_option": None}
    joints = {f"joint_{n}": {"node": n, **limits} for n in range(1, nodes + 1)}
    quiet = {"ours": 0.0, "ours_timeout": 0.0, "drives": 0.0, "drives_timeout": 0.0}
    values = {
        "bus": {"interface": "crtk", "channel": channel, "load_limit": 1.0},
        "joints": joints,
        "feedback": [],
        "heartbeat": quiet,
        "period": 0.02,
    }
    return load(CanopenConfig, from_values(values))


@contextmanager
def ours(config: CanopenConfig, *, machines: bool) -> Iterator[Step]:
    """Yield the cycle of the driver, with or without a power state machine for each axis."""
    layout = plan(config)
    with closing(CanLink(bus_address(config))) as link:
        link.open()
        master = Master(link)
        master.command(NmtCommand.PRE_OPERATIONAL)
        prepare(master, config, layout)
        master.command(NmtCommand.START)
        cycle = Cycle(master, layout.tpdos, layout.rpdos, SentSync(link))
        cycle.start()
        words = list(layout.tpdos.places(OBJECTS["statusword"]).values())
        positions = list(layout.tpdos.places(OBJECTS["position_actual"]).values())
        drives = [Drive402() for _ in words]

        def step() -> bool:
            cycle.begin(0.0)
            complete = cycle.collect(time.monotonic() + PATIENCE)
            values = cycle.values
            sent: list[float] = []
            now = time.monotonic()
            for drive, word, position in zip(drives, words, positions, strict=True):
                sent.append(drive.step(values[word], now) if machines else 0)
                sent.append(values[position])
            cycle.send(sent)
            return complete

        yield step


@contextmanager
def library(config: CanopenConfig, eds: str) -> Iterator[Step]:
    """Yield the same cycle by the canopen library: its PDO objects, its receiving thread, its SYNC."""
    with ours(config, machines=False):
        pass  # the same PDOs in the same drives
    network = canopen.Network()
    network.connect(interface="crtk", channel=config.bus.channel)
    try:
        nodes = [network.add_node(number, eds) for number in config.nodes]
        for node in nodes:
            node.tpdo.read()
            node.rpdo.read()
        received = threading.Event()
        count = 0

        def take(_: Any) -> None:
            nonlocal count
            count += 1
            if count == len(nodes):
                received.set()

        for node in nodes:
            node.tpdo[1].add_callback(take)
        network.nmt.send_command(NmtCommand.START)
        inputs = [(node.tpdo[1][0], node.tpdo[1][1]) for node in nodes]
        outputs = [(node.rpdo[1], node.rpdo[1][0], node.rpdo[1][1]) for node in nodes]

        def step() -> bool:
            nonlocal count
            count = 0
            received.clear()
            network.sync.transmit()
            complete = received.wait(PATIENCE)
            for (word, position), (pdo, control, target) in zip(inputs, outputs, strict=True):
                _ = word.raw
                control.raw = 0
                target.raw = position.raw
                pdo.transmit()
            return complete

        yield step
    finally:
        network.disconnect()


def unpaced(step: Step, seconds: float) -> dict[str, Any]:
    """Run cycles one after the other."""
    for _ in range(SETTLE):
        step()
    took, missed = [], 0
    before, end = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter() + seconds
    while (begin := time.perf_counter()) < end:
        missed += not step()
        took.append(time.perf_counter() - begin)
    after = resource.getrusage(resource.RUSAGE_SELF)
    return {
        "rate": len(took) / seconds,
        "user": (after.ru_utime - before.ru_utime) / len(took),
        "kernel": (after.ru_stime - before.ru_stime) / len(took),
        "p50": float(np.median(took)),
        "p99": float(np.percentile(took, 99)),
        "missed": missed,
    }


def paced(step: Step, rate: float, seconds: float) -> dict[str, Any]:
    """Run cycles on absolute deadlines; one that is over after the next was due is an overrun."""
    period = 1.0 / rate
    for _ in range(SETTLE):
        step()
    late, overruns, missed = [], 0, 0
    cpu, began = time.process_time(), time.monotonic()
    due = began + period
    for _ in range(int(rate * seconds)):
        time.sleep(max(0.0, due - time.monotonic()))
        late.append(time.monotonic() - due)
        missed += not step()
        due += period
        now = time.monotonic()
        if now > due:
            overruns += 1
            due = now  # nothing is caught up
    used, elapsed = time.process_time() - cpu, time.monotonic() - began
    return {
        "cycles": len(late),
        "p50": float(np.median(late)),
        "p99": float(np.percentile(late, 99)),
        "max": max(late),
        "overruns": overruns,
        "missed": missed,
        "cpu": used / elapsed,
    }


def main() -> None:
    """Run one client and print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("client", choices=("ours", "machines", "library"))
    parser.add_argument("channel")
    parser.add_argument("eds")
    parser.add_argument("nodes", type=int)
    parser.add_argument("seconds", type=float)
    parser.add_argument("--rate", type=float, default=0.0)
    parser.add_argument("--busy", action="store_true")
    given = parser.parse_args()
    logging.basicConfig(level=logging.ERROR)
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.freeze()
    config = configuration(given.channel, given.nodes)
    if given.client == "library":
        client = library(config, given.eds)
    else:
        client = ours(config, machines=given.client == "machines")
    with client as step, busy_thread(given.busy):
        rate, seconds = given.rate, given.seconds
        found = paced(step, rate, seconds) if rate else unpaced(step, seconds)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
