"""A serial line behind TCP: the port, the simulated bus that offers it, and the driver on it."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import serial

from crtk_driver_dynamixel import PLUGIN, protocol2
from crtk_driver_dynamixel.bus import Bus
from crtk_driver_dynamixel.config import BusConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConfigError, ConnectionFailed, ConnectionLost, DeviceError
from crtk_drivers.kit.serial_port import SerialPort
from crtk_sim_backends.dynamixel import SIM, RunningSim
from rigs.dynamixel_bench import DynamixelBench, arm_values, driver_at, sim_for
from rigs.waiting import LONG, eventually


class Server:
    """A server of a serial line, with nothing behind it."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(LONG)
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self.client: socket.socket | None = None

    def accept(self) -> socket.socket:
        self.client, _ = self._listener.accept()
        self.client.settimeout(LONG)
        return self.client

    def close(self) -> None:
        if self.client is not None:
            self.client.close()
        self._listener.close()


@pytest.fixture
def server() -> Iterator[Server]:
    made = Server()
    yield made
    made.close()


def test_bytes_cross_it_as_they_are(server: Server) -> None:
    every = bytes(range(256))
    with SerialPort(server.url) as port:
        client = server.accept()
        port.write(every)
        assert client.recv(256, socket.MSG_WAITALL) == every
        client.sendall(every)
        received = b""
        while len(received) < 256:
            received += port.read(time.monotonic() + LONG)
        assert received == every
        assert port.drain() == b""
        deadline = time.monotonic() + 0.02
        assert port.read(deadline) == b""
        assert time.monotonic() >= deadline


def test_a_server_that_hangs_up_is_a_lost_line_and_is_found_again(server: Server) -> None:
    with SerialPort(server.url) as port:
        server.accept().close()
        with pytest.raises(ConnectionLost, match="connection is gone"):
            port.read(time.monotonic() + LONG)
        port.open()
        server.accept().sendall(b"back")
        assert port.read(time.monotonic() + LONG) == b"back"


def test_a_server_that_takes_no_bytes_is_a_lost_line(server: Server) -> None:
    with SerialPort(server.url, 4_000_000) as port:
        server.accept()
        with pytest.raises(ConnectionLost, match="takes no bytes"):
            _fill(port)


def _fill(port: SerialPort) -> None:
    """Write until the buffers of both ends are full."""
    while True:
        port.write(bytes(65536))


def test_nobody_there(server: Server) -> None:
    server.close()
    with pytest.raises(ConnectionFailed, match="server cannot be reached"):
        SerialPort(server.url).open()


def test_its_rate_is_the_servers(server: Server) -> None:
    with SerialPort(server.url) as port:
        port.set_baud(1_000_000)
        with pytest.raises(DeviceError, match="set at the server"):
            port.set_baud(57_600)
        assert port.baud == 1_000_000


@pytest.mark.parametrize(
    "port", ["rfc2217://host:2000", "socket://host", "socket://:5", "socket://host:5?logging=debug"]
)
def test_other_urls_are_refused_when_the_configuration_is_read(port: str) -> None:
    with pytest.raises(ConfigError, match="socket://HOST:PORT"):
        load(PLUGIN.config, from_values({"arm": "arm6", "port": port}))


# ------------------------------------------------------------------------------------- simulated bus


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn(servos="1:xm430-w350,2:xl330-m288", timing="none") as sim:
        yield sim


def url_of(sim: RunningSim, bus: str = "bus1") -> str:
    return f"socket://{sim.host}:{sim.ports[bus]}"


def test_both_ways_lead_to_the_same_servos_and_who_asks_is_answered(sim: RunningSim) -> None:
    ways = (
        Bus(SerialPort(url_of(sim)), latency_budget=1.0),
        Bus(SerialPort(sim.ttys["bus1"]), latency_budget=1.0),
    )
    for bus in ways:
        bus.open()
    try:
        for number in range(3):
            for bus in ways:
                assert bus.ping(1).model == 1020
                assert bus.ping(2).model == 1200
            ways[number % 2].write(1, 65, bytes((number % 2,)))  # LED
            assert ways[1 - number % 2].read(1, 65, 1) == bytes((number % 2,))
        assert all(bus.port.drain() == b"" for bus in ways)
    finally:
        for bus in ways:
            bus.close()


@pytest.mark.real_time  # in a world, a client may come before the simulator knows that the last has gone
def test_one_client_at_a_time(sim: RunningSim) -> None:
    with SerialPort(url_of(sim)) as first, SerialPort(url_of(sim)) as second:
        with pytest.raises(ConnectionLost, match=r"hung up|reset"):
            second.read(time.monotonic() + LONG)
        first.write(protocol2.ping(1))
        assert first.read(time.monotonic() + LONG).startswith(b"\xff\xff\xfd\x00\x01")
    with SerialPort(url_of(sim)) as third:
        third.write(protocol2.ping(2))
        assert third.read(time.monotonic() + LONG).startswith(b"\xff\xff\xfd\x00\x02")


@pytest.mark.real_time  # with the delays of a world, closing with unread answers loses what was sent
def test_nothing_is_lost_of_a_client_that_flushes(sim: RunningSim) -> None:
    heard = sim.control.status()["instructions"]
    with serial.serial_for_url(url_of(sim)) as port:
        for _ in range(200):
            port.write(protocol2.write(1, 65, b"\x01"))
            port.reset_input_buffer()
            port.reset_output_buffer()
    eventually(lambda: sim.control.status()["instructions"] == heard + 200, "all were heard")


# ------------------------------------------------------------------------------------------- driver


@pytest.fixture(scope="module")
def bench() -> Iterator[DynamixelBench]:
    values: dict[str, Any] = arm_values()
    with sim_for(values, timing="none") as sim:
        sim.ttys["bus1"] = url_of(sim)  # what the driver is told
        with driver_at(sim, values) as bench:
            yield bench


def test_an_arm_moves_and_a_line_that_was_lost_comes_back_without_motion(
    bench: DynamixelBench,
) -> None:
    arm = bench.arm
    arm.enable(timeout=LONG)
    assert arm.move_jp(np.full(6, 0.05)).wait(LONG)
    bench.until_still()
    assert np.abs(arm.measured_js().position - 0.05).max() < 0.02
    with bench.nothing_moves(20.0):
        bench.sim.control.inject("unplug")
        bench.until_state("FAULT", "connection is gone")
        bench.sim.control.clear("unplug")
        bench.until_connected()
        bench.until_state("DISABLED")
    arm.enable(timeout=LONG)
    assert arm.move_jp(np.zeros(6)).wait(LONG)


def test_the_rate_of_a_line_is_still_configured() -> None:
    assert BusConfig(port="socket://127.0.0.1:5000", baud=57_600).baud == 57_600
