"""The simulated force sensor, by raw bytes and by a foreign master."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator

import pytest
from pymodbus.client import ModbusTcpClient

from crtk_sim_backends.robotiq.ft300 import SIM, RunningSim
from rigs.ft300_bench import FREE_PORTS, LOAD
from rigs.waiting import LONG, eventually

READ = bytes.fromhex("0903 00B4 0006 84A6")
START = bytes.fromhex("0910 019A 0001 02 0200 CDCA")
STARTED = bytes.fromhex("0910 019A 0001 2152")
STOP = b"\xff" * 50


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS, noise=0.0) as running:
        running.control.inject("load", **LOAD)
        eventually(lambda: running.control.status()["load"][2] == LOAD["fz"], "loaded")
        yield running


@pytest.fixture
def line(sim: RunningSim) -> Iterator[socket.socket]:
    with socket.create_connection((sim.host, sim.ports["tool"]), timeout=LONG) as opened:
        yield opened
        stop(sim, opened)


def stop(sim: RunningSim, line: socket.socket) -> None:
    """End the stream, and take what was on its way, which would come to the next client."""
    line.sendall(STOP)
    eventually(lambda: not sim.control.status()["streams"], "stopped")
    line.settimeout(0.1)
    with contextlib.suppress(TimeoutError):
        while line.recv(1000):
            pass
    line.settimeout(LONG)


def received(line: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += line.recv(count - len(data))
    return data


def test_a_script_starts_reads_and_stops_the_stream(sim: RunningSim, line: socket.socket) -> None:
    line.sendall(START)
    assert received(line, 8) == STARTED
    frames = received(line, 32)
    assert frames[:2] == frames[16:18] == b"\x20\x4e"
    assert struct.unpack("<6h", frames[2:14]) == (1000, -2000, 3000, 1000, -2000, 500)
    stop(sim, line)


def test_while_it_streams_it_answers_nothing_else(sim: RunningSim, line: socket.socket) -> None:
    line.sendall(START)
    assert received(line, 8) == STARTED
    line.sendall(READ + STOP[:49] + b"\0" + STOP[:49])
    data = received(line, 160)
    assert data[::16] == b"\x20" * 10
    assert b"\x09\x03" not in data
    assert sim.control.status()["streams"]


def test_after_it_registers_are_read_again(sim: RunningSim, line: socket.socket) -> None:
    line.sendall(START)
    assert received(line, 8) == STARTED
    stop(sim, line)
    line.sendall(READ)
    answer = received(line, 17)
    assert struct.unpack(">6h", answer[3:15]) == (1000, -2000, 3000, 1000, -2000, 500)


def test_another_master_reads_what_it_is(sim: RunningSim) -> None:
    with ModbusTcpClient(sim.host, port=sim.ports["modbus"], timeout=LONG) as client:
        loads = client.read_input_registers(180, count=6, device_id=9).registers
        assert loads[:3] == [1000, 65536 - 2000, 3000]
        text = client.convert_from_registers(
            client.read_holding_registers(500, count=3, device_id=9).registers,
            client.DATATYPE.STRING,
        )
        assert text == "FT1.05"
        assert client.read_holding_registers(1000, count=1, device_id=9).exception_code == 2
        assert client.write_register(180, 1, device_id=9).exception_code == 2
