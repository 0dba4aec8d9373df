"""The simulated gripper as others find it: the standard library's HTTP client, and pymodbus as master."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from http.client import HTTPConnection
from typing import Any
from urllib.parse import urlencode

import pytest
from pymodbus import ModbusException
from pymodbus.client import ModbusSerialClient

from crtk_sim_backends.schunk.gripper import SIM, RunningSim
from rigs.schunk_bench import BRISK, FREE_PORTS
from rigs.waiting import LONG, eventually

IDLE, ACKNOWLEDGE, GRIP = 0x1, 0x5, 0x1001
READY, SUCCESS, TOGGLE, ERROR, GRIPPED = 0x1, 0x10, 0x20, 0x80, 0x1000


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS, **BRISK, acknowledged=False) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """As it is powered on."""
    shared.control.clear()
    shared.control.inject("unpowered")
    shared.control.clear()
    yield shared
    shared.control.clear()


@pytest.fixture
def web(sim: RunningSim) -> Iterator[HTTPConnection]:
    connection = HTTPConnection(sim.host, sim.ports["http"], timeout=LONG)
    yield connection
    connection.close()


def get(web: HTTPConnection, instance: int, count: int = 1) -> Any:
    web.request("GET", f"/adi/data.json?inst={instance:#06x}&count={count}")
    return json.loads(web.getresponse().read())


def post(web: HTTPConnection, instance: int, value: str) -> Any:
    form = {"Content-Type": "application/x-www-form-urlencoded"}
    web.request(
        "POST", "/adi/update.json", urlencode({"inst": f"{instance:#06x}", "value": value}), form
    )
    return json.loads(web.getresponse().read())["result"]


def command(bits: int, force: int = 0) -> bytes:
    return struct.pack("<Iiii", bits, 0, 0, force)


def test_a_grip_by_its_web_server(sim: RunningSim, web: HTTPConnection) -> None:
    """The handshake of SCHUNK's library, by one connection."""
    sim.control.inject("object", width=0.03)

    def bits() -> int:
        (value,) = get(web, 0x0040)
        assert len(value) == 32
        return int(struct.unpack("<I", bytes.fromhex(value)[:4])[0])

    assert bits() == ERROR, "error on startup"
    assert post(web, 0x0048, command(IDLE).hex()) == 0
    before = bits() & TOGGLE
    assert post(web, 0x0048, command(ACKNOWLEDGE).hex()) == 0
    assert bits() == READY | before ^ TOGGLE
    assert post(web, 0x0048, command(GRIP, 50).hex().upper()) == 0
    eventually(lambda: bits() & GRIPPED and bits() & SUCCESS, "gripped")
    assert sim.control.status()["opening"] == pytest.approx(0.03, abs=0.001)
    assert sim.control.status()["connections"]["http"] == 1


@pytest.mark.parametrize(
    ("instance", "value"),
    [(0x0048, "00"), (0x0048, "zz" * 16), (0x0040, "00" * 16), (0x9999, "00" * 16)],
)
def test_what_is_wrong_is_refused_and_changes_nothing(
    sim: RunningSim, web: HTTPConnection, instance: int, value: str
) -> None:
    before = sim.control.status()["writes"]
    assert post(web, instance, value) == 1
    assert sim.control.status()["writes"] == before
    assert get(web, 0x9999) == []
    assert get(web, 0x0040, 2) == []
    web.request("GET", "/nowhere")
    assert web.getresponse().status == 404


def master(sim: RunningSim) -> Any:
    client = ModbusSerialClient(sim.ttys["serial"], baudrate=115200, timeout=LONG)
    assert client.connect()
    return client


def test_pymodbus_writes_in_parts_and_grips(sim: RunningSim) -> None:
    client = master(sim)
    try:

        def read(address: int, count: int) -> list[int]:
            return list(client.read_holding_registers(address, count=count, device_id=12).registers)

        def write(address: int, image: bytes) -> None:
            client.write_registers(
                address, list(struct.unpack(f">{len(image) // 2}H", image)), device_id=12
            )

        def status() -> int:
            return int(struct.unpack("<I", struct.pack(">2H", *read(0x3F, 2)))[0])

        write(0x47, command(IDLE))
        write(0x47, command(ACKNOWLEDGE))
        assert status() & READY
        write(0x4D, command(0, 50)[12:])  # the force first
        write(0x47, command(GRIP)[:4])
        eventually(lambda: status() & 0x800, "nothing to grip")
        upper = struct.unpack("<f", struct.pack(">2H", *read(0x607, 2)))[0]
        assert upper == pytest.approx(83.0)
        assert read(0x4FF, 1) == [18 << 8], "EGK 40 M"
        for address, count in ((0x3F, 9), (0x10, 1), (0x607, 3)):
            assert (
                client.read_holding_registers(address, count=count, device_id=12).exception_code
                == 2
            )
        assert client.write_registers(0x3F, [0], device_id=12).exception_code == 2
        client.retries = 0
        client.comm_params.timeout_connect = 0.2
        with pytest.raises(ModbusException, match="No response"):
            client.read_holding_registers(0x3F, count=8, device_id=13)
    finally:
        client.close()


def test_commands_count_by_their_change(sim: RunningSim, web: HTTPConnection) -> None:
    post(web, 0x0048, command(ACKNOWLEDGE).hex())
    before = sim.control.status()["taken"]
    for _ in range(3):
        post(web, 0x0048, command(GRIP, 50).hex())
    assert sim.control.status()["taken"] == before + 1
    post(web, 0x0048, bytes(16).hex())
    assert sim.control.status()["error"] == "D9", "a fast stop"
    post(web, 0x0048, command(IDLE).hex())
    post(web, 0x0048, command(GRIP, 50).hex())
    (value,) = get(web, 0x0040)
    assert bytes.fromhex(value)[0] & 0x08, "not feasible before it is acknowledged"
