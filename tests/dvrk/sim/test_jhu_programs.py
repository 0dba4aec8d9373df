"""What JHU's own programs ask of boards, by our own client: their registers, in their order.

Source: ``EthBasePort.cpp``, ``AmpIO.cpp``, ``qlacommand.cpp``, ``qladisp.cpp``, ``dvrktest.cpp`` and
``block1394eth.cpp`` of mechatronics-software. The programs themselves do not run here.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from crtk_sim_backends.dvrk import SIM, RunningSim
from crtk_sim_backends.dvrk.wire import checksum
from rigs.dvrk_bench import boards_of, datagrams
from rigs.dvrk_client import BoardClient
from rigs.waiting import eventually

HUB = 0
RELAY_ON, RELAY_OFF = 0x00030000, 0x00020000
POWER_ON, POWER_OFF = 0x000C0000, 0x00080000
VALID, ENABLE = 0x80000000, 0x30000000


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(boards="6,7", patience=20.0, power_delay=0.02) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> RunningSim:
    """Boards that have just been switched on."""
    for node in range(2):
        shared.control.inject("restart", node=node)
    return shared


@pytest.fixture
def door(sim: RunningSim) -> Iterator[socket.socket]:
    with datagrams(sim) as door:
        yield door


def raw(door: socket.socket, sim: RunningSim, text: str) -> None:
    """Send the bytes of a packet, with the generation of the bus before and the CRC behind them."""
    packet = bytes.fromhex(text)
    door.send(bytes((0, sim.control.status()["generation"])) + packet + checksum(packet))


def test_the_start_of_the_library(sim: RunningSim, door: socket.socket) -> None:
    """Its address to all; of the hub 4, 1 = 0, 0, 7, 12; of each node 4, 7, 12, 0, 15."""
    hub = BoardClient(sim, door)
    hub.write(11, 0x6400FEA9)
    assert hub.read(11) == 0x6400FEA9
    assert hub.read(4) == 0x514C4131
    hub.write(1, 0)
    assert hub.read(0) >> 24 == 0x46
    assert hub.read(7) == 8
    assert hub.read(12) >> 30 == 1
    for node, number in enumerate((6, 7)):
        board = BoardClient(sim, door, node=node)
        found = [board.read(address) for address in (4, 7, 12, 0, 15)]
        assert found[:2] == [0x514C4131, 8]
        assert found[3] >> 24 == 0x40 | number


def test_the_bytes_with_which_relays_are_closed(sim: RunningSim, door: socket.socket) -> None:
    """``qlacommand -c close-relays``: a quadlet, 0x30000 to register 0 of each node; then 0x20000."""
    raw(door, sim, "ff c0 00 00 ff d0 00 00 00 00 00 00 00 03 00 00")
    raw(door, sim, "ff c1 00 00 ff d0 00 00 00 00 00 00 00 03 00 00")
    boards = [BoardClient(sim, door, node=node) for node in range(2)]
    eventually(lambda: all(b.read(0) & 0x30000 == 0x30000 for b in boards), "relays are closed")
    raw(door, sim, "ff c1 00 00 ff d0 00 00 00 00 00 00 00 02 00 00")
    assert boards[1].read(0) & 0x30000 == 0
    assert boards[0].read(0) & 0x30000 == 0x30000


def test_a_display_of_a_board(sim: RunningSim, door: socket.socket) -> None:
    """``qladisp 6``: encoders preset, all off; ``p`` on, ``=`` a current, ``d`` a watchdog that expires."""
    board = BoardClient(sim, door, node=HUB)
    for axis in range(4):
        board.write((axis + 1) << 4 | 4, 0x800000 + 0x1000 * axis + 0x1000)
    for value in (RELAY_OFF, POWER_OFF, 0x0F00):
        board.write(0, value)
    assert board.read(0) & 0xF0F0F == 0
    state = board.state()
    assert [count & 0xFFFFFF for count in state[8:12]] == [0x801000, 0x802000, 0x803000, 0x804000]
    board.write(0, RELAY_ON)
    board.write(0, POWER_ON)
    board.write(0, 0x0F0F)
    eventually(lambda: board.read(0) & 0xA0F0F == 0xA0F0F, "power, relay, four amplifiers")
    board.command(6, [VALID | 0x8100] * 4)
    eventually(lambda: abs((board.state()[4] & 0xFFFF) - 0x8100) <= 1, "the current flows")
    board.write(6, 0x0F05)  # digital outputs
    assert board.state()[2] >> 12 & 0x0F == 5
    board.write(3, 48)  # 0.25 ms
    eventually(lambda: board.read(0) & 0x00800000, "the watchdog expires")
    assert board.read(0) & 0x0F == 0
    board.write(3, 0)
    assert board.read(0) & 0x00800000, "it stays so until power is asked for"
    board.write(0, POWER_ON)
    assert not board.read(0) & 0x00800000


def test_amplifiers_by_the_block_as_the_library_writes_it(
    sim: RunningSim, door: socket.socket
) -> None:
    """``SetPowerEnable``, ``SetAmpEnable``, ``SetMotorCurrent``, ``WriteAllBoards``: one block a board."""
    board = BoardClient(sim, door, node=1)
    board.command(7, [0] * 4, POWER_ON | RELAY_ON)
    eventually(lambda: board.read(0) & 0x80000, "motors have their voltage")
    board.command(7, [VALID | ENABLE | 0x8000] * 3 + [0])
    eventually(
        lambda: [m & ENABLE for m in board.state()[28:]] == [ENABLE] * 3 + [0], "they are on"
    )
    board.command(6, [VALID | 0x9000] * 4)  # of another board
    assert [m & 0xFFFF for m in board.state()[28:]] == [0x8000] * 4
    board.command(7, [0x20000000] * 4, POWER_OFF)
    assert [m & ENABLE for m in board.state()[28:]] == [0] * 4
    assert boards_of(sim)[1]["power"] is False


def test_the_test_of_a_controller(sim: RunningSim, door: socket.socket) -> None:
    """``dvrktest``: serial numbers by both memories, power without a watchdog, a current of 0x8500."""
    board = BoardClient(sim, door, node=1)
    board.write(8, 0x03000000 | 0x1FFF00)
    assert board.read(8) & 0x0F == 0
    assert board.read(9) == 64
    words = board.block(0x2000, 4)
    assert b"".join(word.to_bytes(4) for word in words).rstrip(b"\xff") == b"FPGA 1234-07"
    serial = b""
    for at in range(11):
        board.write(0x3000, 0x03000000 | at << 8)
        serial += bytes((board.read(0x3002) & 0xFF,))
    assert serial == b"QLA 5678-07"
    for address, value in ((0, RELAY_ON), (3, 0), (0, POWER_ON), (0, 0xFFFF)):
        board.write(address, value)
    eventually(lambda: board.read(0) & 0xA0F0F == 0xA0F0F, "power, relay, four amplifiers")
    board.command(7, [VALID | 0x8500, 0, 0, 0])
    eventually(lambda: abs((board.state()[4] & 0xFFFF) - 0x8500) < 0x200, "the current is measured")
    assert board.state()[4] >> 16 > 0
    board.command(7, [VALID | 0x8000, 0, 0, 0])
    eventually(lambda: abs((board.state()[4] & 0xFFFF) - 0x8000) < 0x10, "and none")


def test_quadlets_and_blocks_of_any_address_are_answered(
    sim: RunningSim, door: socket.socket
) -> None:
    """``quad1394eth`` and ``block1394eth`` read what they are told to; what there is nothing of is 0."""
    board = BoardClient(sim, door, node=HUB)
    for address in (0, 5, 6, 8, 9, 10, 13, 14, 0x10, 0x11, 0x14, 0x15, 0x16, 0x50, 0x1000, 0x3002):
        board.read(address)
    assert board.block(0, 1)[0] >= 0
    assert board.block(0x4000, 3) == [0, 0, 0]
    assert len(board.block(0, 28)) == 28
