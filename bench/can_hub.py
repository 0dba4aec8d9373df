"""Round trips and frames per second over each door of the CAN hub; ``python -m bench.can_hub``.

Three processes: the hub, a program that sends a frame of eight bytes, and one that sends it back; both
at the same door, both with unmodified python-can. The rows with a bit rate show what pacing adds to the
time that two frames take on such a bus.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import can

from bench.can_echo import END
from bench.report import options, show, spread
from crtk_sim_backends.can import SIM, RunningSim, frames

FLOWS = (("crtk", 0), ("socketcand", 0), ("slcan", 0), ("crtk", 1_000_000), ("crtk", 250_000))
DATA = bytes(range(1, 9))
CAN_ID = 0x123
WAIT = 5.0
IN_FLIGHT = 16


def addresses(sim: RunningSim, door: str) -> list[dict[str, Any]]:
    """Return the options of two python-can buses at a door."""
    if door == "crtk":
        return [{"interface": "crtk", "channel": sim.paths["crtk"]}] * 2
    if door == "socketcand":
        where = {"host": sim.host, "port": sim.ports["socketcand"], "channel": "can0"}
        return [{"interface": "socketcand", "tcp_tune": True, **where}] * 2
    return [
        {"interface": "slcan", "channel": tty, "sleep_after_open": 0} for tty in sim.ttys.values()
    ]


@contextmanager
def echoed(door: str, bitrate: int) -> Iterator[tuple[RunningSim, can.BusABC]]:
    """Start a hub and the program that echoes; yield the hub and our bus."""
    with SIM.spawn(bitrate=bitrate, socketcand_port=0, terminals=2) as sim:
        mine, other = addresses(sim, door)
        echo = subprocess.Popen([sys.executable, "-m", "bench.can_echo", json.dumps(other)])
        try:
            with can.Bus(**mine) as bus:
                while round_trip(bus, 0.2) is None:
                    pass
                yield sim, bus
                bus.send(message(END))
                echo.wait(WAIT)
        finally:
            echo.kill()
            echo.wait()


def message(can_id: int = CAN_ID) -> can.Message:
    """Return the frame that goes around."""
    return can.Message(arbitration_id=can_id, data=DATA, is_extended_id=False)


def round_trip(bus: can.BusABC, timeout: float = WAIT) -> float | None:
    """Return the seconds until a frame is back; None when it is not in time."""
    sent = message()
    began = time.perf_counter()
    bus.send(sent, timeout=timeout)
    return None if bus.recv(timeout) is None else time.perf_counter() - began


def stream(bus: can.BusABC, count: int) -> float:
    """Keep `IN_FLIGHT` frames under way until `count` have come back; return frames per second."""
    sent = message()
    for _ in range(IN_FLIGHT):
        bus.send(sent, timeout=WAIT)
    began = time.perf_counter()
    for _ in range(count):
        if bus.recv(WAIT) is None:
            raise RuntimeError("a frame was lost")
        bus.send(sent, timeout=WAIT)
    seconds = time.perf_counter() - began
    for _ in range(IN_FLIGHT):
        bus.recv(WAIT)
    return 2 * count / seconds


def row(door: str, bitrate: int, trips: int) -> list[str]:
    """Measure one door."""
    with echoed(door, bitrate) as (sim, bus):
        times = [round_trip(bus) or WAIT for _ in range(trips)]
        before = sim.control.status()
        rate = stream(bus, trips)
        after = sim.control.status()
    cpu = (after["cpu"] - before["cpu"]) / (after["frames"] - before["frames"]) * 1e6
    wire = 2e6 * frames.exact_bits(frames.pack(CAN_ID, DATA)) / bitrate if bitrate else 0.0
    pace = f"{bitrate // 1000} kbit/s" if bitrate else "-"
    return [door, pace, *spread(times, 1e6), f"{wire:.0f}", f"{rate:.0f}", f"{cpu:.1f}"]


def main() -> None:
    """Measure and print."""
    chosen = options(__doc__ or "", trips=(4000, "round trips for each row"))
    rows = [row(door, bitrate, int(chosen.trips)) for door, bitrate in FLOWS]
    show(
        "CAN hub: there and back, 8 bytes, python-can at both ends",
        (
            "door",
            "bit rate",
            "p50 µs",
            "p99 µs",
            "max µs",
            "on the wire µs",
            "frames/s",
            "hub CPU µs/frame",
        ),
        rows,
        [
            "on the wire: the time of the two frames at this bit rate; the rest is the machine.",
            f"frames/s: both directions, with {IN_FLIGHT} frames under way.",
        ],
    )


if __name__ == "__main__":
    main()
