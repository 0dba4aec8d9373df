"""Simulated boards, by packets that are written here byte for byte: registers, power, watchdog, motion."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from crtk_sim_backends.dvrk import SIM, RunningSim
from rigs.dvrk_bench import datagrams
from rigs.dvrk_client import BoardClient
from rigs.waiting import eventually

POWER_ON = 0x000C0000
RELAY_ON = 0x00030000
ENABLE = 0x30000000
VALID = 0x80000000
MIDDLE = 0x8000


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(boards="7") as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> RunningSim:
    """A board that has just been switched on."""
    shared.control.inject("restart")
    return shared


@pytest.fixture
def client(sim: RunningSim) -> Iterator[BoardClient]:
    with datagrams(sim) as door:
        yield BoardClient(sim, door)


def test_the_question_of_dvrks_own_program_is_answered(
    sim: RunningSim, client: BoardClient
) -> None:
    """Register 4 of node 63, label 2: QLA1, from node 0; CRC 0, and the extra bytes."""
    client.door.send(bytes.fromhex("01 00 ff ff 08 40 ff d0 00 00 00 00 00 04 58 ff b1 82"))
    told = client.door.recv(100)
    assert told[:20] == bytes.fromhex("ff d0 08 60 ff c0 00 00 00 00 00 00 51 4c 41 31 00 00 00 00")
    assert len(told) == 28
    assert told[20:22] == bytes((0x10, sim.control.status()["generation"]))


def test_registers_at_the_start_are_those_of_a_board_that_dvrk_has_seen(
    client: BoardClient,
) -> None:
    assert client.read(0) == 0x47000000
    assert client.read(7) == 8
    assert client.read(12) >> 30 == 1  # FPGA V3
    assert client.read(3) == 0
    assert client.read(0x14) == 0x800000


def test_a_damaged_request_is_not_answered(sim: RunningSim, client: BoardClient) -> None:
    before = sim.control.status()["damaged"]
    client.door.send(bytes.fromhex("01 00 ff ff 08 40 ff d0 00 00 00 00 00 04 58 ff b1 83"))
    eventually(lambda: sim.control.status()["damaged"] > before, "it is counted")
    assert client.read(7) == 8


def test_a_request_of_another_bus_is_dropped_and_said_so(
    sim: RunningSim, client: BoardClient
) -> None:
    client.door.send(bytes.fromhex("01 fe ff c0 08 40 ff d0 00 00 00 00 00 07 80 13 0c 9a"))
    told = client.door.recv(100)
    assert len(told) == 8
    assert told[:2] == bytes((2, sim.control.status()["generation"]))


def test_a_current_turns_a_motor_once_it_has_power_and_is_enabled(client: BoardClient) -> None:
    client.command(7, [VALID | ENABLE | MIDDLE + 0x800] + [0] * 3)
    assert client.state()[28] & ENABLE == 0, "no power yet"
    client.command(7, [0] * 4, POWER_ON | RELAY_ON)
    eventually(lambda: client.read(0) & 0x000F0000 == 0x000F0000, "motors have their voltage")
    client.command(7, [ENABLE] + [0] * 3)
    eventually(lambda: client.state()[28] & ENABLE == ENABLE, "its amplifier is on")
    eventually(lambda: (client.state()[8] & 0xFFFFFF) > 0x800000 + 1000, "it turns")
    found = client.state()
    assert abs((found[4] & 0xFFFF) - MIDDLE - 0x800) <= 1
    assert found[12] >> 30 == 1  # forwards
    assert found[28] & 0xFFFF == MIDDLE + 0x800


def test_a_watchdog_that_nobody_feeds_switches_motors_off(client: BoardClient) -> None:
    client.command(7, [0] * 4, POWER_ON)
    client.write(3, 0x3000)  # 64 ms
    client.command(7, [ENABLE] * 4)
    eventually(lambda: client.state()[1] & 1 << 23, "it has expired")
    assert [value & ENABLE for value in client.state()[28:]] == [0] * 4
    client.command(7, [ENABLE] * 4)
    assert client.state()[28] & ENABLE == 0, "not before power is asked for again"
    client.command(7, [0] * 4, POWER_ON)
    assert not client.state()[1] & 1 << 23


def test_an_encoder_counts_from_what_it_was_set_to(client: BoardClient) -> None:
    client.write(0x24, 0x812345)
    assert client.state()[9] & 0xFFFFFF == 0x812345
