"""One client of a simulated chain, in a process of its own: ours or dynamixel-sdk. Prints a figure as JSON.

A cycle reads current, velocity and position of every servo (10 bytes) and writes a goal position to each.
"""

from __future__ import annotations

import argparse
import json
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from bench.interpreter import SWITCH_INTERVAL, busy_thread

ADDRESS, LENGTH = 126, 10
FIELDS = ((126, 2), (128, 4), (132, 4))
GOAL, GOAL_LENGTH = 116, 4
SETTLE = 0.5
"""Seconds that are not counted."""

Cycle = Callable[[], int]
"""Returns how many servos it has data of."""


@contextmanager
def ours(port: str, baud: int, ids: list[int], fast: bool) -> Iterator[Cycle]:
    """Our transaction layer."""
    from crtk_driver_dynamixel.bus import Bus, ServoLink
    from crtk_drivers.kit.serial_port import SerialPort

    bus = Bus(SerialPort(port, baud), dict.fromkeys(ids, ServoLink(return_delay=0.0)))
    bus.open()
    goals = np.full(len(ids), 2048, "<i4")
    record = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
    reading = bus.sync_group(ids, ADDRESS, LENGTH, fast=fast)
    writing = bus.write_group(ids, GOAL, GOAL_LENGTH)

    def cycle() -> int:
        result = reading.run()
        np.frombuffer(result.block, record)
        writing.run(goals.tobytes())
        return len(ids) if result.complete else sum(data is not None for data in result.data)

    try:
        yield cycle
    finally:
        bus.close()


@contextmanager
def sdk(port: str, baud: int, ids: list[int], fast: bool) -> Iterator[Cycle]:
    """The group classes of dynamixel-sdk, as its examples use them."""
    from dynamixel_sdk import (
        COMM_SUCCESS,
        GroupSyncRead,
        GroupSyncWrite,
        PacketHandler,
        PortHandler,
    )

    handler = PortHandler(port)
    handler.openPort()
    handler.setBaudRate(baud)
    packets = PacketHandler(2.0)
    reading = GroupSyncRead(handler, packets, ADDRESS, LENGTH)
    for id in ids:
        reading.addParam(id)
    writing = GroupSyncWrite(handler, packets, GOAL, GOAL_LENGTH)
    read = reading.fastSyncRead if fast else reading.txRxPacket
    goal = list(struct.pack("<i", 2048))

    def cycle() -> int:
        good = 0
        if read() == COMM_SUCCESS:
            for id in ids:
                for address, size in FIELDS:
                    if reading.isAvailable(id, address, size):
                        reading.getData(id, address, size)
                good += reading.isAvailable(id, ADDRESS, LENGTH)
        writing.clearParam()
        for id in ids:
            writing.addParam(id, goal)
        writing.txPacket()
        return good

    try:
        yield cycle
    finally:
        handler.closePort()


def measure(cycle: Cycle, seconds: float, count: int) -> dict[str, Any]:
    """Run cycles back to back and return what they took."""
    settled = time.monotonic() + SETTLE
    while time.monotonic() < settled:
        cycle()
    durations = []
    found = 0
    begin, cpu = time.monotonic(), time.thread_time()
    end = last = begin
    while end - begin < seconds:
        found += cycle()
        end = time.monotonic()
        durations.append(end - last)
        last = end
    cpu = time.thread_time() - cpu
    return {
        "rate": len(durations) / (end - begin),
        "cpu": cpu / len(durations),
        "load": cpu / (end - begin),
        "p50": float(np.median(durations)),
        "p99": float(np.percentile(durations, 99)),
        "missing": 1.0 - found / (len(durations) * count),
    }


def main() -> None:
    """Measure one client."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("client", choices=("ours", "sdk"))
    parser.add_argument("port")
    parser.add_argument("baud", type=int)
    parser.add_argument("count", type=int, help="of servos, with ids from 1")
    parser.add_argument("seconds", type=float)
    parser.add_argument("--fast", action="store_true", help="with fast sync reads")
    parser.add_argument("--busy", action="store_true", help="beside a busy thread")
    given = parser.parse_args()
    sys.setswitchinterval(SWITCH_INTERVAL)
    client = {"ours": ours, "sdk": sdk}[given.client]
    ids = list(range(1, given.count + 1))
    with client(given.port, given.baud, ids, given.fast) as cycle, busy_thread(given.busy):
        found = measure(cycle, given.seconds, given.count)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
