"""Faults of the bus, of its adapter and of servos: every kind does what it says, and ends."""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import dynamixel_sdk as sdk
import pytest
from fastcrc import crc16

from crtk_sim_backends.control import ControlError
from crtk_sim_backends.dynamixel import RunningSim, SimStartError
from crtk_sim_backends.dynamixel.injection import BEGIN, KINDS, REPLIES
from rigs.dynamixel_clients import (
    CURRENT,
    GOAL_POSITION,
    HARDWARE_ERROR,
    MODE,
    POSITION,
    TORQUE,
    Status,
    Wire,
    hand,
    instruction,
    legacy,
    read,
    running,
    statuses,
    sync_read,
    vendor_at,
    wire_at,
    write,
)
from rigs.waiting import eventually

PING_1, ANSWER_1 = instruction(1, 0x01), 14
SERVOS = "1:xm430-w350,2:xm430-w350,3:xm430-w350"


@pytest.fixture
def sim() -> Iterator[RunningSim]:
    with running(servos=SERVOS) as sim:
        yield sim


@pytest.fixture
def wire(sim: RunningSim) -> Iterator[Wire]:
    with wire_at(sim) as wire:
        yield wire


def intact(packet: bytes) -> bool:
    return struct.unpack("<H", packet[-2:])[0] == crc16.umts(packet[:-2])


# The wire


def test_drop_every_second(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("drop", id=1, every=2)
    assert [len(wire.ask(PING_1)) for _ in range(4)] == [1, 0, 1, 0]
    assert len(wire.ask(instruction(2, 0x01))) == 1
    answers = wire.ask(sync_read(POSITION, 4, 3, 1, 2))  # the third of servo 1
    assert [answer.number for answer in answers] == [3, 1, 2]
    answers = wire.ask(sync_read(POSITION, 4, 3, 1, 2))
    assert [answer.number for answer in answers] == [3, 2]  # it did talk: the chain goes on
    sim.control.clear("drop")
    assert len(wire.ask(PING_1)) == 1


def test_lost_instructions_have_no_effect(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("lost")
    assert wire.ask(write(1, 65, b"\x01")) == []
    sim.control.clear()
    assert wire.ask(read(1, 65, 1), 12) == [Status(1, 0, b"\x00")]


def test_crc(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("crc", id=1)
    packet = wire.ask_raw(PING_1, ANSWER_1)
    assert len(packet) == ANSWER_1
    assert not intact(packet)
    with vendor_at(sim) as vendor:
        assert vendor.ping(1)[1] == sdk.COMM_RX_CORRUPT
        assert vendor.ping(2)[1] == sdk.COMM_SUCCESS


def test_corrupt_changes_one_byte_and_the_seed_says_which() -> None:
    changed = []
    for seed in (1, 1, 2):
        with running(servos=SERVOS, seed=seed) as sim, wire_at(sim) as wire:
            good = wire.ask_raw(PING_1, ANSWER_1)
            sim.control.inject("corrupt")
            packets = [wire.ask_raw(PING_1, ANSWER_1) for _ in range(5)]
            for packet in packets:
                assert sum(a != b for a, b in zip(good, packet, strict=True)) == 1
            changed.append(packets)
    assert changed[0] == changed[1] != changed[2]


def test_truncate(sim: RunningSim, wire: Wire) -> None:
    good = wire.ask_raw(PING_1, ANSWER_1)
    sim.control.inject("truncate", missing=5)
    wire.send(PING_1)
    assert wire.rest() == good[:-5]


def test_noise_before_the_header(sim: RunningSim, wire: Wire) -> None:
    good = wire.ask_raw(PING_1, ANSWER_1)
    sim.control.inject("noise", bytes=7)
    wire.send(PING_1)
    answer = wire.rest()
    assert len(answer) == ANSWER_1 + 7
    assert answer[7:] == good


def test_late_answers_come_between_others(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("late", id=1, seconds=0.3)
    start = time.monotonic()
    wire.send(PING_1, instruction(2, 0x01))
    assert [s.number for s in statuses(wire.receive(ANSWER_1))] == [2]
    assert [s.number for s in statuses(wire.receive(ANSWER_1))] == [1]
    assert time.monotonic() - start >= 0.3


def test_two_servos_with_one_id(sim: RunningSim, wire: Wire) -> None:
    good = wire.ask_raw(read(1, POSITION, 4), 15)
    sim.control.inject("duplicate_id", id=1)
    collided = wire.ask_raw(read(1, POSITION, 4), 15)
    assert not intact(collided)
    assert all(a & b == b for a, b in zip(good, collided, strict=True))  # zeros win
    assert wire.ask(write(1, 65, b"\x00"), 11) == [Status(1, 0, b"")]  # what is equal agrees


def test_really_two_servos_with_one_id(sim: RunningSim, wire: Wire) -> None:
    sim.control.call("place", id=2, angle=1.0)
    wire.ask(write(2, 7, b"\x01"), 11)
    assert not intact(wire.ask_raw(read(1, POSITION, 4), 15))
    assert len(wire.ask(PING_1, ANSWER_1)) == 1


def test_duplicate_id_with_protocol_1() -> None:
    with running(servos="1:ax-12a") as sim, wire_at(sim) as wire:
        sim.control.inject("duplicate_id")
        packet = wire.ask_raw(legacy(1, 0x02, b"\x00\x02"), 8)
        assert ~sum(packet[2:-1]) & 0xFF != packet[-1]


def test_echo(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("echo")
    wire.send(PING_1)
    answer = wire.receive(len(PING_1) + ANSWER_1)
    assert answer[: len(PING_1)] == PING_1
    assert statuses(answer[len(PING_1) :])[0].number == 1


def test_latency_of_the_adapter(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("latency", milliseconds=50)
    answered = []
    for _ in range(12):
        assert len(wire.ask(PING_1, ANSWER_1)) == 1
        answered.append(time.monotonic())
    assert answered[-1] - answered[0] > 11 * 0.04  # one answer in every 50 ms, at most


def test_an_adapter_that_stalls_keeps_all_in_order(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("stall")
    for number in (2, 1, 3):
        assert wire.ask(instruction(number, 0x01)) == []
    sim.control.clear("stall")
    assert [s.number for s in statuses(wire.receive(3 * ANSWER_1))] == [2, 1, 3]
    assert [s.number for s in wire.ask(PING_1, ANSWER_1)] == [1]


@pytest.mark.parametrize("chain", ["goes_on", "stalls"])
def test_a_silent_servo_in_a_sync_read(sim: RunningSim, wire: Wire, chain: str) -> None:
    sim.control.inject("silent", id=2, chain=chain)
    expected = {"goes_on": [1, 3], "stalls": [1]}[chain]
    assert [s.number for s in wire.ask(sync_read(POSITION, 4, 1, 2, 3))] == expected
    assert wire.ask(instruction(2, 0x01)) == []
    assert wire.ask(sync_read(POSITION, 4, 1, 2, 3, code=0x8A)) == []
    wire.ask(write(2, 65, b"\x01"))
    sim.control.clear("silent")
    assert wire.ask(read(2, 65, 1), 12) == [Status(2, 0, b"\x00")]


@pytest.mark.parametrize(("chain", "expected"), [("goes_on", [1, 3]), ("stalls", [1])])
def test_a_missing_servo_in_a_sync_read(chain: str, expected: list[int]) -> None:
    with running(servos=SERVOS, chain=chain) as sim, wire_at(sim) as wire:
        assert [s.number for s in wire.ask(sync_read(POSITION, 4, 1, 9, 3))] == expected


def test_unplug_and_plug_in_again(sim: RunningSim) -> None:
    link = Path(sim.ttys["bus1"])
    before = os.readlink(link)
    vendor_error = None
    with Wire(str(link)) as wire:
        assert len(wire.ask(PING_1, ANSWER_1)) == 1
        wire.ask(write(1, 112, struct.pack("<I", 44)), 11)
        sim.control.inject("unplug")
        assert not link.is_symlink()
        try:
            wire.send(PING_1)
            os.read(wire.fileno(), 1)
        except OSError as error:
            vendor_error = error
        assert vendor_error is not None
        sim.control.clear("unplug")
        assert link.is_symlink()
        assert os.readlink(link) != before  # the old one is still open here
    with Wire(str(link)) as wire:
        assert len(wire.ask(PING_1, ANSWER_1)) == 1
        assert wire.ask(read(1, 112, 4), 15) == [Status(1, 0, struct.pack("<I", 44))]


def test_a_frozen_simulator(sim: RunningSim, wire: Wire) -> None:
    sim.suspend()
    wire.send(PING_1)
    assert wire.receive(1, 0.7) == b""
    sim.resume()
    assert len(statuses(wire.receive(ANSWER_1))) == 1


def test_all_faults_of_the_wire_at_once(sim: RunningSim, wire: Wire) -> None:
    for kind in REPLIES:
        sim.control.inject(kind)
    wire.send(PING_1)
    wire.rest()
    sim.control.clear()
    assert len(wire.ask(PING_1, ANSWER_1)) == 1


# Servos


def test_stuck(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("stuck", id=1)
    wire.ask(write(1, TORQUE, b"\x01"), 11)
    wire.ask(write(1, 112, struct.pack("<I", 100)), 11)
    wire.ask(write(1, GOAL_POSITION, struct.pack("<I", 2148)), 11)

    def measured() -> tuple[int, int, int]:
        current, velocity, position = struct.unpack(
            "<hii", wire.ask(read(1, CURRENT, 10), 21)[0].data
        )
        return current, velocity, position

    eventually(lambda: measured()[0] > 100)
    assert measured()[1:] == (0, 2048)
    sim.control.clear("stuck")
    eventually(lambda: measured()[2] == 2148)


def test_push(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("push", id=1, torque=-1.0)
    eventually(lambda: sim.control.outputs("bus1/1")["bus1/1"]["angle"] < -0.2)
    sim.control.clear()
    eventually(lambda: sim.control.outputs("bus1/1")["bus1/1"]["velocity"] == 0.0)


@pytest.mark.parametrize(
    ("kind", "parameters", "bits", "torque"),
    [
        ("overload", {}, 0x20, 0),
        ("overheat", {}, 0x04, 0),
        ("voltage", {"volts": 18.0}, 0x01, 1),
        ("hardware_error", {"bit": 4}, 0x10, 0),
    ],
)
def test_hardware_errors(
    sim: RunningSim,
    wire: Wire,
    kind: str,
    parameters: dict[str, float],
    bits: int,
    torque: int,
) -> None:
    wire.ask(write(1, TORQUE, b"\x01"), 11)
    wire.ask(write(2, TORQUE, b"\x01"), 11)
    sim.control.inject(kind, id=1, **parameters)
    eventually(lambda: wire.ask(read(1, HARDWARE_ERROR, 1), 12)[0].data[0] == bits)
    assert wire.ask(read(1, TORQUE, 1), 12) == [Status(1, 0x80, bytes((torque,)))]
    assert wire.ask(read(2, TORQUE, 1), 12) == [Status(2, 0, b"\x01")]
    if kind not in ("overload", "hardware_error"):
        sim.control.clear(kind)
    wire.ask(instruction(1, 0x08), 11)
    eventually(lambda: wire.ask(read(1, HARDWARE_ERROR, 1)) == [Status(1, 0, b"\x00")])


def test_power_off_and_on(sim: RunningSim, wire: Wire) -> None:
    wire.ask(write(1, MODE, b"\x04"), 11)
    wire.ask(write(1, TORQUE, b"\x01"), 11)
    sim.control.call("place", id=1, angle=7.0)
    sim.control.inject("power_off")
    assert wire.ask(PING_1) == []
    sim.control.clear("power_off")
    eventually(lambda: wire.ask(PING_1) != [])
    assert wire.ask(read(1, TORQUE, 1), 12) == [Status(1, 0, b"\x00")]
    assert wire.ask(read(1, MODE, 1), 12) == [Status(1, 0, b"\x04")]
    (answer,) = wire.ask(read(1, POSITION, 4), 15)
    assert 0 <= struct.unpack("<i", answer.data)[0] <= 4095  # full turns are forgotten


def test_stuffing_values_come_through_right(sim: RunningSim, wire: Wire) -> None:
    sim.control.inject("stuffing", id=1, seed=3)
    stuffed = 0
    for _ in range(100):
        wire.send(sync_read(CURRENT, 10, 1))
        head = wire.receive(7)
        packet = head + wire.receive(struct.unpack_from("<H", head, 5)[0])
        assert len(statuses(packet)[0].data) == 10
        stuffed += hand("FF FF FD FD") in packet
    assert stuffed > 20
    sim.control.clear("stuffing")
    assert wire.ask(read(1, POSITION, 4), 15) == [Status(1, 0, hand("00 08 00 00"))]


# Files, and what is refused


def test_a_timeline_with_events(tmp_path: Path) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text(
        "- {when: instruction, kind: echo, duration: 1.0}\n"
        "- {when: torque_on, after: 0.1, kind: overload, id: 2}\n"
    )
    with running(servos=SERVOS, faults=str(path)) as sim, wire_at(sim) as wire:
        wire.ask(PING_1, ANSWER_1)

        def echoes() -> bool:
            wire.send(PING_1)
            return len(wire.rest()) > ANSWER_1

        eventually(echoes)
        eventually(lambda: not echoes())
        wire.ask(write(2, TORQUE, b"\x01"), 11)
        eventually(lambda: wire.ask(read(2, HARDWARE_ERROR, 1), 12)[0].data == b"\x20")


def test_memory_that_is_claimed_to_be_something_else(sim: RunningSim, wire: Wire) -> None:
    true = wire.ask(read(2, HARDWARE_ERROR - 2, 4), 15)[0].data
    wire.ask(write(2, 168, HARDWARE_ERROR.to_bytes(2, "little")), 11)  # indirect data 1
    sim.control.inject("claim", id=2, address=HARDWARE_ERROR, data="ff")
    claimed = true[:2] + b"\xff" + true[3:]
    assert wire.ask(read(2, HARDWARE_ERROR - 2, 4), 15)[0].data == claimed
    assert wire.ask(read(2, 224, 1), 12)[0].data == b"\xff"
    assert wire.ask(read(1, HARDWARE_ERROR, 1), 12)[0].data == b"\x00"
    sim.control.clear("claim")
    assert wire.ask(read(2, HARDWARE_ERROR - 2, 4), 15)[0].data == true


@pytest.mark.parametrize(
    ("kind", "parameters", "reason"),
    [
        ("overlod", {}, "did you mean 'overload'"),
        ("drop", {"ide": 1}, "did you mean 'id'"),
        ("drop", {"id": 9}, "no servo has the id 9 on bus 1: 1, 2, 3"),
        ("drop", {"every": 0}, "every must lie in"),
        ("drop", {"bus": 2}, "there is no bus 2"),
        ("silent", {"chain": "stall"}, "did you mean 'stalls'"),
        ("overload", {"duration": 1.0}, "unknown parameter"),
        ("voltage", {}, "needs the parameter 'volts'"),
        ("claim", {"address": 70, "data": "x"}, "data must be bytes in hexadecimal"),
    ],
)
def test_unknown_kinds_and_wrong_parameters(
    sim: RunningSim, kind: str, parameters: dict[str, object], reason: str
) -> None:
    with pytest.raises(ControlError, match=reason):
        sim.control.inject(kind, **parameters)
    assert sim.control.status()["faults"] == []


def test_a_wrong_fault_file(tmp_path: Path) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text("- {at: 1, kind: drop, id: 1}\n- {at: 1, kind: drop, id: 33}\n")
    with pytest.raises(SimStartError, match="no servo has the id 33"), running(faults=str(path)):
        pass
    path.write_text("- {at: 1, kind: dorp}\n")
    with pytest.raises(SimStartError, match=r"line 1.*did you mean 'drop'"):
        running(faults=str(path)).__enter__()


def test_every_kind_has_an_effect() -> None:
    wire = {*REPLIES, "lost", "message", "late", "silent", "echo", "latency", "stall", "unplug"}
    assert set(KINDS) == wire | set(BEGIN)
