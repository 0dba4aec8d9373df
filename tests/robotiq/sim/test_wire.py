"""The simulated gripper as others find it: pymodbus as master, others' frames, both dialects of text."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from pymodbus import FramerType, ModbusException
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from crtk_sim_backends.robotiq import SIM, RunningSim
from rigs.robotiq_bench import AJAR, FREE_PORTS, eventually
from rigs.waiting import LONG


def hexed(text: str) -> bytes:
    return bytes.fromhex(text.replace(" ", ""))


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS, activated=False) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """As it is powered on, with nothing between its fingers."""
    shared.control.inject("unpowered")
    shared.control.clear()
    yield shared
    shared.control.clear()


def status(sim: RunningSim, name: str) -> Any:
    return sim.control.call("status")[name]


MASTERS: dict[str, Callable[[RunningSim], Any]] = {
    "serial": lambda sim: ModbusSerialClient(sim.ttys["serial"], baudrate=115200, timeout=LONG),
    "tool": lambda sim: ModbusTcpClient(
        sim.host, port=sim.ports["tool"], framer=FramerType.RTU, timeout=LONG
    ),
    "modbus": lambda sim: ModbusTcpClient(sim.host, port=sim.ports["modbus"], timeout=LONG),
}


@contextmanager
def master(sim: RunningSim, way: str) -> Iterator[Any]:
    client = MASTERS[way](sim)
    assert client.connect()
    try:
        yield client
    finally:
        client.close()


@pytest.mark.parametrize("way", MASTERS)
def test_pymodbus_activates_and_grips(sim: RunningSim, way: str) -> None:
    sim.control.inject("object", width=0.04)
    with master(sim, way) as client:

        def read() -> list[int]:
            return list(client.read_input_registers(2000, count=3, device_id=9).registers)

        assert read()[0] == 0
        client.write_registers(1000, [0, 0, 0], device_id=9)
        client.write_register(1000, 0x0100, device_id=9)
        assert read()[0] == 0x1100
        eventually(lambda: read()[0] == 0x3100, "activated")
        told = client.readwrite_registers(
            read_address=2000,
            read_count=3,
            write_address=1000,
            values=[0x0900, 0x00FF, 0xFFFF],
            device_id=9,
        )
        assert told.registers[1] == 0x00FF, "the echo"
        eventually(lambda: read()[0] == 0xB900, "closed onto the object")
        assert status(sim, "opening") == pytest.approx(0.04, abs=0.003)


@pytest.fixture
def ajar(sim: RunningSim) -> RunningSim:
    """The same, whose activation soon ends at what lies there, until that is taken away."""
    sim.control.inject("object", width=AJAR)
    return sim


@contextmanager
def talk(sim: RunningSim, port: str) -> Iterator[Callable[[bytes, int], bytes]]:
    """Send bytes, and return as many as are expected."""
    with socket.create_connection((sim.host, sim.ports[port]), timeout=LONG) as peer:

        def ask(data: bytes, size: int) -> bytes:
            peer.sendall(data)
            answer = b""
            while len(answer) < size and (piece := peer.recv(size - len(answer))):
                answer += piece
            return answer

        yield ask


def test_the_frames_of_pyrobotiqgripper(ajar: RunningSim) -> None:
    """FC4, FC16 of three registers, FC16 of one, FC23 that writes two."""
    with talk(ajar, "tool") as ask:
        assert ask(hexed("09 10 03E8 0003 06 0000 0000 0000 7330"), 8) == hexed(
            "09 10 03E8 0003 0130"
        )
        ask(hexed("09 10 03E8 0003 06 0100 0000 0000 72E1"), 8)
        assert ask(hexed("09 03 07D0 0001 85CF"), 7) == hexed("09 03 02 1100 55D5")
        eventually(
            lambda: ask(hexed("09 03 07D0 0001 85CF"), 7) == hexed("09 03 02 3100 4C15"), "active"
        )
        one = hexed("09 10 03E8 0001 02 0900")
        assert ask(one + crc(one), 8)[:6] == hexed("09 10 03E8 0001")
        two = hexed("09 17 07D0 0003 03E9 0002 04 00FF FF10")
        assert ask(two + crc(two), 11)[:3] == hexed("09 17 06")
        assert status(ajar, "written") == "09 00 00 ff ff 10"


def crc(data: bytes) -> bytes:
    """From pymodbus, which is neither the simulator's nor ours."""
    from pymodbus.framer.rtu import FramerRTU

    return FramerRTU.compute_CRC(data).to_bytes(2)


def test_what_is_not_there_is_an_exception(sim: RunningSim) -> None:
    before = status(sim, "writes")
    with talk(sim, "tool") as ask:
        nowhere = hexed("09 03 07D1 0003")
        assert ask(nowhere + crc(nowhere), 5) == hexed("09 83 02 4133")
        coil = hexed("09 05 0000 FF00")
        assert ask(coil + crc(coil), 5)[:3] == hexed("09 85 01")
        none = hexed("09 03 07D0 0000")
        assert ask(none + crc(none), 5)[:3] == hexed("09 83 03")
    assert status(sim, "writes") == before


@pytest.mark.parametrize(
    "frame",
    ["09 03 07D0 0001 85CE", "0A 03 07D0 0001 85FC", "09 03 07D0"],
    ids=["CRC", "another unit", "cut"],
)
def test_a_serial_unit_keeps_silent(sim: RunningSim, frame: str) -> None:
    """And what comes after a pause is understood."""
    with talk(sim, "tool") as ask:
        peer_question = hexed("09 03 07D0 0001 85CF")
        assert ask(hexed(frame), 0) == b""
        clock = lambda: sim.control.status()["time"]  # noqa: E731
        forgotten = clock() + 0.05
        eventually(lambda: clock() > forgotten, "a pause")
        assert ask(peer_question, 7)[:3] == hexed("09 03 02")


def test_a_unit_that_does_not_answer_is_no_exception_for_pymodbus(sim: RunningSim) -> None:
    with master(sim, "serial") as client:
        client.comm_params.timeout_connect = 0.2
        client.retries = 0
        sim.control.inject("unit_silent")
        with pytest.raises(ModbusException, match="No response"):
            client.read_input_registers(2000, count=3, device_id=9)


def test_clients_of_the_tool_share_one_line(sim: RunningSim) -> None:
    """Half a frame from one and half from the other is a request; the answer goes to either, or to both."""
    question = hexed("09 03 07D0 0001 85CF")
    with (
        socket.create_connection((sim.host, sim.ports["tool"]), timeout=LONG) as one,
        socket.create_connection((sim.host, sim.ports["tool"]), timeout=LONG) as other,
    ):
        eventually(lambda: status(sim, "connections")["tool"] == 2, "both connected")
        heard = {one: b"", other: b""}
        for peer in heard:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for count in range(1, 21):
            while sum(map(len, heard.values())) < 7 * count:
                one.sendall(question[:4])
                time.sleep(0.003)  # halves that come apart by more are no request
                other.sendall(question[4:])
                while found := select.select([one, other], [], [], 1.0)[0]:
                    for peer in found:
                        heard[peer] += peer.recv(100)
                    if sum(map(len, heard.values())) >= 7 * count:
                        break
    answer = hexed("09 03 02 0000 5985")
    assert all(answer in data for data in heard.values())
    assert any(len(data) != 7 * data.count(answer) for data in heard.values())


def test_text_in_both_dialects(ajar: RunningSim) -> None:
    with talk(ajar, "urcap") as ask:
        assert ask(b"GET STA\n", 6) == b"STA 0\n"
        assert ask(b"SET ACT 1 GTO 0\n", 3) == b"ack"
        eventually(lambda: ask(b"GET STA\n", 6) == b"STA 3\n", "active")
        ajar.control.clear("object")
        assert ask(b"set SPE 255\n", 3) == b"ack"
        assert ask(b"SET POS 255 FOR 10 GTO 1\n", 3) == b"ack"
        assert ask(b"GET PRE\n", 8) == b"PRE 255\n"
        eventually(lambda: ask(b"GET OBJ", 1) == b"3", "there, as URScript asks")
        assert ask(b"GET FLT", 2) == b"00"
        assert ask(b"GET PRE", 3) == b"255"
        ajar.control.inject("gripper_fault", code=0xB)
        assert ask(b"GET FLT\n", 7) == b"FLT 11\n"
        assert ask(b"GET XYZ\n", 2) == b"?\n"
        assert ask(b"SET POS 300\n", 2) == b"?\n"


MESSAGES: dict[str, tuple[bytes, bytes, bytes, bytes]] = {
    "tool": (
        hexed("09 03 07D0 0001 85CF"),
        hexed("09 03 02 0000 5985"),
        hexed("09 10 03E8 0003 06 0000 0000 0000 7330"),
        hexed("09 10 03E8 0003 0130"),
    ),
    "modbus": (
        hexed("0001 0000 0006 09 03 07D0 0001"),
        hexed("0001 0000 0005 09 03 02 0000"),
        hexed("0002 0000 000D 09 10 03E8 0003 06 0000 0000 0000"),
        hexed("0002 0000 0006 09 10 03E8 0003"),
    ),
    "urcap": (b"GET STA\n", b"STA 0\n", b"SET ACT 0 GTO 0\n", b"ack"),
}
"""What reads, its answer, what writes, and its answer, by the port."""


@pytest.mark.parametrize("port", list(MESSAGES))
@pytest.mark.parametrize("part", ["request", "answer"])
def test_one_message_is_lost_doubled_or_late(sim: RunningSim, port: str, part: str) -> None:
    read, told, write, taken = MESSAGES[port]
    heard_when_lost = 0 if part == "request" else 1
    with talk(sim, port) as ask:

        def heard_of(effect: str, answers: bytes, **more: Any) -> int:
            """Write once, then read; return how many writes it has heard by the first answer."""
            sim.control.clear()
            before = status(sim, "writes")
            assert ask(write, len(taken)) == taken
            sim.control.inject("message", part=part, of="write", number=2, effect=effect, **more)
            assert ask(write, len(taken)) == taken
            ask(write, 0)
            assert ask(read, len(told)) == answers[: len(told)]
            heard = status(sim, "writes") - before - 2
            assert ask(b"", len(answers) - len(told)) == answers[len(told) :]
            assert ask(read, len(told)) == told, "nothing else comes"
            return int(heard)

        assert heard_of("lost", told) == heard_when_lost
        assert heard_of("late", told + taken, seconds=0.5) == heard_when_lost
        assert heard_of("doubled", 2 * taken + told) == (2 if part == "request" else 1)


def test_a_message_of_any_kind_may_be_the_one(sim: RunningSim) -> None:
    read, told, write, taken = MESSAGES["urcap"]
    with talk(sim, "urcap") as ask:
        sim.control.inject("message", number=2, effect="lost")
        assert ask(write, len(taken)) == taken
        ask(read, 0)
        assert ask(write, len(taken)) == taken
        assert ask(read, len(told)) == told


def test_the_text_server_is_silent_without_power(sim: RunningSim) -> None:
    with talk(sim, "urcap") as ask:
        sim.control.inject("unpowered")
        ask(b"GET STA\n", 0)
        sent = status(sim, "time")
        eventually(lambda: status(sim, "time") > sent + 0.2, "it has heard that")
        sim.control.clear()
        assert ask(b"GET OBJ\n", 6) == b"OBJ 0\n"


def test_an_activation_may_be_slow() -> None:
    with SIM.spawn(**FREE_PORTS, activated=False, sweep_speed=0.01) as slow:
        begin = status(slow, "opening")
        slow.control.inject("activated")
        eventually(lambda: status(slow, "opening") > begin + 0.001, "it moves")
        went, since = status(slow, "opening") - begin, time.monotonic()
        eventually(lambda: status(slow, "opening") > begin + 0.003, "it goes on")
        assert status(slow, "state") == "activating"
        assert (status(slow, "opening") - begin - went) / (time.monotonic() - since) < 0.02


def test_a_major_fault_stops_it_until_a_reset(ajar: RunningSim) -> None:
    with talk(ajar, "urcap") as ask:
        ask(b"SET ACT 1\n", 3)
        eventually(lambda: ask(b"GET STA\n", 6) == b"STA 3\n", "active")
        ajar.control.clear("object")
        ask(b"SET POS 255 SPE 0 GTO 1\n", 3)
        ajar.control.inject("gripper_fault", code=0xE)
        ajar.control.clear("gripper_fault")
        here = status(ajar, "position")
        assert ask(b"GET FLT\n", 7) == b"FLT 14\n"
        assert status(ajar, "position") == here
        ask(b"SET ACT 0 GTO 0\n", 3)
        ask(b"SET ACT 1\n", 3)
        assert ask(b"GET FLT\n", 6) == b"FLT 0\n"


def test_an_activation_opens_and_drops_what_is_held(ajar: RunningSim) -> None:
    """What the driver must never do by itself."""
    with talk(ajar, "urcap") as ask:
        ask(b"SET ACT 1\n", 3)
        eventually(lambda: ask(b"GET STA\n", 6) == b"STA 3\n", "active")
        ajar.control.clear("object")
        ajar.control.inject("object", width=0.03)
        ask(b"SET POS 255 SPE 255 GTO 1\n", 3)
        eventually(lambda: ask(b"GET OBJ\n", 6) == b"OBJ 2\n", "held")
        assert status(ajar, "opening") == pytest.approx(0.03, abs=0.002)
        ask(b"SET ACT 0\n", 3)
        ask(b"SET ACT 1\n", 3)
        eventually(lambda: status(ajar, "opening") > 0.08, "opened")
