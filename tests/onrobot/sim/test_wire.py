"""The simulated gripper as others find it: pymodbus as master, on each way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from crtk_sim_backends.onrobot import SIM, RunningSim
from rigs.onrobot_bench import FREE_PORTS
from rigs.waiting import LONG, eventually

UNIT = 65


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS, start_lag=0.1) as sim:
        yield sim


MASTERS: dict[str, Callable[[RunningSim], Any]] = {
    "modbus": lambda sim: ModbusTcpClient(sim.host, port=sim.ports["modbus"], timeout=LONG),
    "serial": lambda sim: ModbusSerialClient(sim.ttys["serial"], baudrate=1_000_000, timeout=LONG),
    "tool": lambda sim: ModbusTcpClient(
        sim.host, port=sim.ports["tool"], framer=FramerType.RTU, timeout=LONG
    ),
}


@pytest.fixture(params=MASTERS)
def master(sim: RunningSim, request: pytest.FixtureRequest) -> Iterator[Any]:
    client = MASTERS[request.param](sim)
    assert client.connect()
    yield client
    client.close()
    sim.control.inject(
        "unpowered"
    )  # what is let go of is closed onto further, and a busy gripper is deaf
    sim.control.clear()


def read(client: Any, address: int, count: int = 1) -> list[int]:
    return list(client.read_holding_registers(address, count=count, device_id=UNIT).registers)


def test_a_grip_as_programs_for_an_rg2_do_it(sim: RunningSim, master: Any) -> None:
    assert read(master, 0x0600)[0] == 0x20
    master.write_registers(0, [400, 900, 16], device_id=UNIT)
    eventually(lambda: read(master, 258, 18)[9] == 900 and read(master, 0x010C) == [0], "open")
    sim.control.inject("object", width=0.04)
    master.write_registers(0, [400, 0], device_id=UNIT)
    master.write_register(2, 16, device_id=UNIT)
    sim.control.inject("stuck_busy")  # until the other command has come
    eventually(lambda: read(master, 0x010C)[0] & 1, "busy")
    master.write_registers(0, [400, 900, 16], device_id=UNIT)
    sim.control.clear("stuck_busy")
    eventually(lambda: read(master, 0x010C) == [2], "grips, and has ignored the other command")
    status = read(master, 258, 18)
    assert status[9] == pytest.approx(400, abs=5)
    assert status[17] == status[9]


def test_what_is_not_there_is_an_exception(master: Any) -> None:
    assert master.read_holding_registers(0x0300, count=1, device_id=UNIT).exception_code == 2
    assert master.read_input_registers(0x010C, count=1, device_id=UNIT).exception_code == 1
    assert master.write_registers(2, [16, 0], device_id=UNIT).exception_code == 2


def test_the_compute_box_answers_for_who_is_not_there_and_cuts_the_power(sim: RunningSim) -> None:
    client = MASTERS["modbus"](sim)
    assert client.connect()
    try:
        assert client.read_holding_registers(0x0600, count=1, device_id=70).exception_code == 11
        sim.control.inject("safety_switch", number=2)
        eventually(lambda: sim.control.call("status")["latched"] == 0x20, "latched")
        sim.control.clear()
        assert read(client, 0x010C)[0] == 0x20
        assert not client.write_register(0, 2, device_id=63).isError()
        assert read(client, 0x010C)[0] == 0
    finally:
        client.close()


def test_a_vacuum_gripper() -> None:
    with SIM.spawn(**FREE_PORTS, model="vgc10") as sim:
        client = MASTERS["modbus"](sim)
        assert client.connect()
        try:
            assert read(client, 0x0600) == [0x11]
            assert read(client, 2) == [500]
            client.write_registers(0, [0x0100 + 60, 0], device_id=UNIT)
            eventually(lambda: read(client, 0x0102)[0] > 550, "vacuum in channel a")
            assert read(client, 0x0103) == [0]
            client.write_register(0, 0x0200, device_id=UNIT)
            sim.control.inject("leak", channel="a", rate=20.0)
            eventually(lambda: read(client, 0x0102)[0] < 100, "leaked away, the pump idle")
        finally:
            client.close()
