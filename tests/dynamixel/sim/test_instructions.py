"""Every instruction, as bytes on the tty: what the vendor's SDK cannot send, or throws away."""

from __future__ import annotations

import struct
import termios
from collections.abc import Iterator

import pytest
from fastcrc import crc16

from rigs.dynamixel_clients import (
    CURRENT,
    EVERYONE,
    GOAL_POSITION,
    HARDWARE_ERROR,
    MODE,
    POSITION,
    STATUS_LEVEL,
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
    wire_at,
    write,
)
from rigs.waiting import eventually

RESULT_FAIL, INSTRUCTION, CRC, RANGE, LENGTH, LIMIT, ACCESS = range(1, 8)
MOVING = 122
CLEAR = hand("01 44 58 4C 22")
STORE, RESTORE = hand("01 43 54 52 4C"), hand("02 43 54 52 4C")
CENTRE = hand("00 08 00 00")

SERVOS = "1:xm430-w350,2:xm430-w350,3:xl330-m288,4:xl430-w250,5:2xl430-w250"


@pytest.fixture
def wire() -> Iterator[Wire]:
    with running(servos=SERVOS) as sim, wire_at(sim) as wire:
        yield wire


def done(number: int, error: int = 0, data: bytes = b"") -> list[Status]:
    return [Status(number, error, data)]


def test_the_first_example_of_the_manual(wire: Wire) -> None:
    wire.send(hand("FF FF FD 00 01 03 00 01 19 4E"))
    assert statuses(wire.receive(14)) == done(1, 0, struct.pack("<HB", 1020, 52))
    wire.send(hand("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"))
    assert statuses(wire.receive(15)) == done(1, 0, CENTRE)


def test_broadcast_ping_in_the_order_of_ids(wire: Wire) -> None:
    assert [s.number for s in wire.ask(instruction(EVERYONE, 0x01), 5 * 14)] == [1, 2, 3, 4, 5]


def test_broadcasts_have_no_answer_but_act(wire: Wire) -> None:
    assert wire.ask(write(EVERYONE, 65, b"\x01")) == []
    assert wire.ask(read(EVERYONE, 65, 1)) == []
    assert wire.ask(instruction(EVERYONE, 0x04, struct.pack("<HI", GOAL_POSITION, 1000))) == []
    assert wire.ask(instruction(EVERYONE, 0x05)) == []
    assert [s.data for s in wire.ask(sync_read(65, 1, 1, 3, 5), 36)] == [b"\x01"] * 3
    assert wire.ask(read(4, GOAL_POSITION, 4), 15) == done(4, 0, struct.pack("<I", 1000))
    assert wire.ask(instruction(EVERYONE, 0x06, b"\xff")) == []  # would give all of them one id
    assert wire.ask(read(4, 65, 1), 12) == done(4, 0, b"\x01")


def test_action_without_anything_registered(wire: Wire) -> None:
    assert wire.ask(instruction(1, 0x05), 11) == done(1, INSTRUCTION)


def test_unknown_instructions_and_lengths_that_make_no_sense(wire: Wire) -> None:
    assert wire.ask(instruction(1, 0x77), 11) == done(1, INSTRUCTION)
    assert wire.ask(instruction(1, 0x03, b"\x74\x00"), 11) == done(1, LENGTH)
    assert wire.ask(read(1, POSITION, 0), 11) == done(1, LENGTH)


def test_a_wrong_crc_is_told_and_nothing_done(wire: Wire) -> None:
    spoilt = bytearray(write(1, 65, b"\x01"))
    spoilt[-1] ^= 1
    assert wire.ask(bytes(spoilt), 11) == done(1, CRC)
    assert wire.ask(read(1, 65, 1), 12) == done(1, 0, b"\x00")


def test_sync_read_answers_in_the_order_of_the_list(wire: Wire) -> None:
    answers = wire.ask(sync_read(POSITION, 4, 3, 1, 2), 45)
    assert answers == [Status(n, 0, CENTRE) for n in (3, 1, 2)]


def test_group_reads_tell_the_error_of_each(wire: Wire) -> None:
    wire.ask(write(1, STATUS_LEVEL, b"\x01"), 11)
    answers = wire.ask(sync_read(700, 4, 1, 2), 22)
    assert answers == [Status(1, ACCESS, b""), Status(2, ACCESS, b"")]


def test_sync_and_bulk_write(wire: Wire) -> None:
    parameters = struct.pack("<HHBIBI", GOAL_POSITION, 4, 1, 1111, 2, 2222)
    wire.send(instruction(EVERYONE, 0x83, parameters))
    parameters = struct.pack("<BHHBBHHI", 3, 65, 1, 1, 4, GOAL_POSITION, 4, 3333)
    wire.send(instruction(EVERYONE, 0x93, parameters))
    bulk = struct.pack("<BHHBHHBHH", 2, GOAL_POSITION, 4, 3, 65, 1, 4, GOAL_POSITION, 4)
    assert wire.ask(instruction(EVERYONE, 0x92, bulk), 42) == [
        Status(2, 0, struct.pack("<I", 2222)),
        Status(3, 0, b"\x01"),
        Status(4, 0, struct.pack("<I", 3333)),
    ]


def test_fast_sync_read_is_one_packet_with_running_crcs(wire: Wire) -> None:
    wire.ask(write(2, HARDWARE_ERROR, b"\x01"), 11)
    packet = wire.ask_raw(sync_read(POSITION, 4, 2, 1, code=0x8A), 8 + 2 * 8)
    assert packet[:8] == hand("FF FF FD 00 FE 11 00 55")
    assert packet[8:14] == b"\x00\x02" + CENTRE
    assert packet[16:22] == b"\x00\x01" + CENTRE
    for end in (14, 22):
        assert packet[end : end + 2] == struct.pack("<H", crc16.umts(packet[:end]))


def test_fast_bulk_read(wire: Wire) -> None:
    parameters = struct.pack("<BHHBHH", 3, POSITION, 4, 1, 146, 1)
    packet = wire.ask_raw(instruction(EVERYONE, 0x9A, parameters), 8 + 8 + 5)
    assert packet[4:8] == hand("FE 0E 00 55")
    assert (packet[8:14], packet[16:18], packet[18]) == (b"\x00\x03" + CENTRE, b"\x00\x01", 28)
    assert packet[-2:] == struct.pack("<H", crc16.umts(packet[:-2]))


def test_only_fast_reads_are_not_stuffed() -> None:
    with running(servos="1:xm430-w350") as sim, wire_at(sim) as wire:
        values = struct.pack("<hii", -1, -3, 2048)
        assert hand("FF FF FD") in values
        sim.control.inject("stuffing", id=1)
        assert wire.ask_raw(sync_read(CURRENT, 10, 1), 22)[9:20] == hand(
            "FF FF FD FD FF FF FF 00 08 00 00"
        )
        sim.control.inject("stuffing", id=1)
        assert wire.ask_raw(sync_read(CURRENT, 10, 1, code=0x8A), 22)[10:20] == values


@pytest.mark.parametrize("numbers", [(1, 5), (1, 9), (5,)])
def test_a_fast_read_that_one_servo_cannot_do_is_silent(
    wire: Wire, numbers: tuple[int, ...]
) -> None:
    assert wire.ask(sync_read(POSITION, 4, *numbers, code=0x8A)) == []


def test_fast_read_needs_the_firmware() -> None:
    with running(servos="1:xm430-w350@44,2:xm430-w350@45") as sim, wire_at(sim) as wire:
        assert wire.ask(sync_read(POSITION, 4, 1, code=0x8A)) == []
        assert len(wire.ask_raw(sync_read(POSITION, 4, 2, code=0x8A), 16)) == 16


def test_clear_forgets_full_turns_at_rest() -> None:
    with running(servos="1:xm430-w350") as sim, wire_at(sim) as wire:
        wire.ask(write(1, MODE, b"\x04"), 11)
        sim.control.call("place", id=1, angle=20.0)
        turned = 2048 + round(20.0 / 6.283185307179586 * 4096)
        assert wire.ask(read(1, POSITION, 4), 15) == done(1, 0, struct.pack("<i", turned))
        assert wire.ask(instruction(1, 0x10, b"\x02"), 11) == done(1, RANGE)
        assert wire.ask(instruction(1, 0x10, CLEAR), 11) == done(1)
        within = struct.pack("<i", turned % 4096)
        assert wire.ask(read(1, POSITION, 4), 15) == done(1, 0, within)
        sim.control.inject("push", id=1, torque=1.0)
        eventually(lambda: sim.control.status()["servos"]["bus1/1"]["velocity"] > 0.5)
        assert wire.ask(instruction(1, 0x10, CLEAR), 11) == done(1, RESULT_FAIL)


def test_clear_is_taken_as_soon_as_moving_says_that_it_stands() -> None:
    with running(servos="1:xm430-w350") as sim, wire_at(sim) as wire:
        wire.ask(write(1, MODE, b"\x04"), 11)
        sim.control.call("place", id=1, angle=(3100 - 2048) / 4096 * 6.283185307179586)
        wire.ask(write(1, TORQUE, b"\x01"), 11)
        for goal in (5100, -996, 5100):
            # Into another turn each time, half a turn away: that full turn is forgotten.
            wire.ask(write(1, GOAL_POSITION, struct.pack("<i", goal)), 11)
            eventually(lambda: wire.ask(read(1, MOVING, 1), 12) == done(1, 0, b"\x01"))
            eventually(lambda: wire.ask(read(1, MOVING, 1), 12) == done(1, 0, b"\x00"))
            assert wire.ask(instruction(1, 0x10, CLEAR), 11) == done(1)


def test_turns_are_lost_at_reboot() -> None:
    with running(servos="1:xm430-w350") as sim, wire_at(sim) as wire:
        sim.control.call("place", id=1, angle=-7.0)
        (before,) = wire.ask(read(1, POSITION, 4), 15)
        assert struct.unpack("<i", before.data)[0] < -2000
        wire.ask(instruction(1, 0x08), 11)
        eventually(lambda: wire.ask(read(1, POSITION, 4)) != [])
        (after,) = wire.ask(read(1, POSITION, 4), 15)
        difference = struct.unpack("<i", after.data)[0] - struct.unpack("<i", before.data)[0]
        assert difference == 4096


def test_backup_of_the_control_table(wire: Wire) -> None:
    profile = struct.pack("<I", 77)
    assert wire.ask(instruction(1, 0x20, RESTORE), 11) == done(1, RESULT_FAIL)
    wire.ask(write(1, 112, profile), 11)
    wire.ask(write(1, TORQUE, b"\x01"), 11)
    assert wire.ask(instruction(1, 0x20, STORE), 11) == done(1, RESULT_FAIL)
    wire.ask(write(1, TORQUE, b"\x00"), 11)
    assert wire.ask(instruction(1, 0x20, STORE), 11) == done(1)
    assert wire.ask(read(1, 147, 1), 12) == done(1, 0, b"\x01")
    wire.ask(write(1, 112, bytes(4)), 11)
    assert wire.ask(instruction(1, 0x20, RESTORE), 11) == done(1)
    eventually(lambda: wire.ask(instruction(1, 0x01)) != [])
    assert wire.ask(read(1, 112, 4), 15) == done(1, 0, profile)


def test_a_shadow_obeys_without_an_answer() -> None:
    servos = "2:xm540-w270,3:xm540-w270&2"
    with running(servos=servos) as sim, wire_at(sim) as wire:
        assert wire.ask(write(2, TORQUE, b"\x01")) == done(2)
        assert wire.ask(read(3, TORQUE, 1), 12) == done(3, 0, b"\x01")
        assert wire.ask(write(2, GOAL_POSITION, struct.pack("<i", 2500))) == done(2)

        def positions() -> list[int]:
            answers = wire.ask(sync_read(POSITION, 4, 2, 3), 30)
            return [struct.unpack("<i", answer.data)[0] for answer in answers]

        eventually(lambda: positions() == [2500, 2500])
        wire.send(instruction(EVERYONE, 0x83, struct.pack("<HHBI", GOAL_POSITION, 4, 2, 2000)))
        assert wire.ask(read(3, GOAL_POSITION, 4), 15) == done(3, 0, struct.pack("<I", 2000))
        eventually(lambda: positions() == [2000, 2000])


def test_a_servo_hears_only_its_own_baud_rate(wire: Wire) -> None:
    wire.set_speed(termios.B57600)
    assert wire.ask(instruction(1, 0x01)) == []
    wire.set_speed(termios.B1000000)
    assert len(wire.ask(instruction(1, 0x01), 14)) == 1


# Protocol 1.0


def test_protocol_1_on_the_same_wire() -> None:
    servos = "1:xm430-w350,12:ax-12a,13:mx-64-1.0"
    with running(servos=servos) as sim, wire_at(sim) as wire:

        def ask(packet: bytes, length: int) -> bytes:
            wire.send(packet)
            return wire.receive(length)

        assert ask(legacy(12, 0x01), 6) == hand("FF FF 0C 02 00 F1")
        assert ask(legacy(12, 0x02, b"\x00\x02"), 8)[5:7] == b"\x0c\x00"
        assert ask(legacy(12, 0x02, b"\x24\x02"), 8)[5:7] == b"\x00\x02"  # 512
        assert ask(legacy(12, 0x03, b"\x06\x00\x01\x00\x03"), 6)[4] == 0  # limits 256, 768
        assert ask(legacy(12, 0x03, b"\x1e\xff\x00"), 6)[4] == 0x02  # angle limit
        assert ask(legacy(12, 0x08), 6)[4] == 0x40  # the AX series knows no reboot
        assert ask(legacy(12, 0x03, b"\x24\x00\x00"), 6)[4] == 0x08  # read only
        assert ask(legacy(12, 0x05), 6)[4] == 0x40  # nothing registered
        assert ask(legacy(12, 0x04, b"\x1e\x00\x02"), 6)[4] == 0
        assert ask(legacy(12, 0x02, b"\x2c\x01"), 7)[5] == 1
        assert ask(legacy(12, 0x05), 6)[4] == 0
        assert ask(legacy(12, 0x03, b"\x0c\x01"), 6)[4] == 0x08  # out of range
        wire.send(legacy(EVERYONE, 0x83, b"\x1e\x02\x0c\x58\x02\x0d\xd0\x07"))
        assert ask(legacy(12, 0x02, b"\x1e\x02"), 8)[5:7] == struct.pack("<H", 600)
        assert ask(legacy(13, 0x02, b"\x1e\x02"), 8)[5:7] == struct.pack("<H", 2000)
        assert ask(legacy(EVERYONE, 0x92, b"\x00\x02\x0c\x1e\x01\x0d\x18"), 15)[2::8][0] == 12
        spoilt = bytearray(legacy(12, 0x01))
        spoilt[-1] ^= 1
        assert ask(bytes(spoilt), 6)[4] == 0x10
        assert wire.ask(instruction(1, 0x01), 14) == done(1, 0, struct.pack("<HB", 1020, 52))


def test_a_servo_of_the_x_series_changes_its_protocol() -> None:
    with running(servos="1:xm430-w350") as sim, wire_at(sim) as wire:
        assert wire.ask(write(1, 13, b"\x01"), 11) == done(1)
        assert wire.ask(instruction(1, 0x01)) == []
        wire.send(legacy(1, 0x02, bytes((POSITION, 4))))
        assert wire.receive(10)[5:9] == CENTRE
        wire.send(legacy(1, 0x03, b"\x0d\x02"))
        assert len(wire.receive(6)) == 6
        assert len(wire.ask(instruction(1, 0x01), 14)) == 1
