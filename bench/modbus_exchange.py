"""Exchanges with a gripper in Modbus RTU: pymodbus beside frames of our own, on one simulated line.

Each writes the command and reads the status with function 23, free running, in a process of its own
(ours: in every second exchange, since two answers in a row must not look alike; the others read); the
simulated unit answers as fast as it can, then with the times of a line at 115200 bit/s, and then beside a
thread that computes in Python. Median and p99 of an exchange, exchanges a second, and CPU of the client.

    python -m bench.modbus_exchange
"""

from __future__ import annotations

import multiprocessing
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Final, NamedTuple

from bench.report import options, show, spread
from crtk_driver_robotiq.links import GripperRegisters
from crtk_driver_robotiq.registers import Command
from crtk_drivers.kit.modbus_frames import Rtu
from crtk_drivers.kit.modbus_link import ModbusLink
from crtk_drivers.kit.serial_port import SerialPort
from crtk_sim_backends.robotiq import SIM

BAUD: Final = 115_200
PATIENCE: Final = 1.0
"""Seconds in which an exchange must end."""
SWITCH_INTERVAL: Final = 0.0005
"""Seconds, as in a driver's own process."""
FREE: Final = {"tool_port": 0, "modbus_port": 0, "controller_port": 0, "urcap_port": 0}
LINES: Final = {
    "no line": {"baud": 0, "turnaround": 0.0},
    "115200 bit/s": {"baud": BAUD, "turnaround": 0.0014},
}

Exchange = Callable[[int], object]


class Figures(NamedTuple):
    """What a client has measured: seconds of each exchange, and of CPU."""

    times: list[float]
    cpu: float


def ours(port: str) -> Exchange:
    """Return an exchange by frames of our own."""
    link = ModbusLink(GripperRegisters(), SerialPort(port, BAUD), Rtu(9), PATIENCE)
    link.open(time.monotonic() + PATIENCE)

    def exchange(position: int) -> object:
        command = Command(go=True, position=position, speed=255)
        answer = link.exchange(command, time.monotonic() + PATIENCE)
        assert answer is not None
        return answer

    return exchange


def theirs(port: str) -> Exchange:
    """Return an exchange by pymodbus."""
    from pymodbus.client import ModbusSerialClient

    client = ModbusSerialClient(port, baudrate=BAUD, timeout=PATIENCE)
    assert client.connect()

    def exchange(position: int) -> object:
        answer = client.readwrite_registers(
            read_address=2000,
            read_count=3,
            write_address=1000,
            values=[0x0900, position, 0xFF00],
            device_id=9,
        )
        assert not answer.isError()
        return answer.registers

    return exchange


CLIENTS: Final = {"frames of our own": ours, "pymodbus": theirs}


def measure(
    make: Callable[[str], Exchange], port: str, seconds: float, *, busy: bool, told: Connection
) -> None:
    """Exchange for some seconds, and tell the figures."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    stop = threading.Event()
    worker = threading.Thread(target=_compute, args=(stop,))
    if busy:
        worker.start()
    exchange = make(port)
    times: list[float] = []
    end = time.monotonic() + seconds
    before = time.thread_time()
    while (begin := time.monotonic()) < end:
        exchange(len(times) % 256)
        times.append(time.monotonic() - begin)
    cpu = time.thread_time() - before
    stop.set()
    told.send(Figures(times, cpu))
    if busy:
        worker.join()


def _compute(stop: threading.Event) -> None:
    value = 0
    while not stop.is_set():
        value += 1


def run(name: str, line: str, seconds: float, *, busy: bool) -> list[str]:
    """Let a client run at a simulated line of its own, and return its row."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    with SIM.spawn(**FREE, **LINES[line]) as sim:
        process = context.Process(
            target=measure,
            args=(CLIENTS[name], sim.ttys["serial"], seconds),
            kwargs={"busy": busy, "told": there},
        )
        process.start()
        figures: Figures = here.recv()
        process.join()
    median, p99, longest = spread(figures.times, 1e3, 2)
    count = len(figures.times)
    where = line + (", beside a busy thread" if busy else "")
    cpu = 1e6 * figures.cpu / count
    return [where, name, f"{count / seconds:.0f}", median, p99, longest, f"{cpu:.0f}"]


def main() -> int:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(5.0, "of each measurement"))
    cases = (("no line", False), ("115200 bit/s", False), ("115200 bit/s", True))
    rows = [run(name, line, given.seconds, busy=busy) for line, busy in cases for name in CLIENTS]
    columns = ("line", "client", "exchanges/s", "median ms", "p99 ms", "max ms", "CPU µs")
    show("Modbus RTU: write the command and read the status (FC23)", columns, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
