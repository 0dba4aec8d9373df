"""The simulator's own packet code, against the manual and against anything."""

from __future__ import annotations

import struct

import pytest
from fastcrc import crc16 as other_crc16
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.dynamixel.bus import Bus, make_servos
from crtk_sim_backends.dynamixel.config import parse_servos
from crtk_sim_backends.dynamixel.packets import (
    Instruction,
    Parser1,
    Parser2,
    checksum,
    crc16,
    fast_status,
    legacy_status,
    status,
)
from rigs.dynamixel_clients import hand, instruction, legacy, statuses, write

# ROBOTIS e-manual, DYNAMIXEL Protocol 2.0, the examples of "Instruction Details".
INSTRUCTIONS = {
    "FF FF FD 00 01 03 00 01 19 4E": (1, 0x01, ""),
    "FF FF FD 00 FE 03 00 01 31 42": (254, 0x01, ""),
    "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15": (1, 0x02, "84 00 04 00"),
    "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89": (1, 0x03, "74 00 00 02 00 00"),
    "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E": (1, 0x04, "68 00 C8 00 00 00"),
    "FF FF FD 00 01 03 00 05 02 CE": (1, 0x05, ""),
    "FF FF FD 00 01 04 00 06 01 A1 E6": (1, 0x06, "01"),
    "FF FF FD 00 01 03 00 08 2F 4E": (1, 0x08, ""),
    "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC": (1, 0x10, "01 44 58 4C 22"),
    "FF FF FD 00 01 08 00 20 01 43 54 52 4C 16 F5": (1, 0x20, "01 43 54 52 4C"),
    "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA": (254, 0x82, "84 00 04 00 01 02"),
    "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87": (
        254,
        0x83,
        "74 00 04 00 01 96 00 00 00 02 AA 00 00 00",
    ),
    "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05": (
        254,
        0x92,
        "01 90 00 02 00 02 92 00 01 00",
    ),
    "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68": (
        254,
        0x93,
        "01 20 00 02 00 A0 00 02 1F 00 01 00 50",
    ),
}
STATUSES = {
    "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D": (1, 0, "06 04 26"),
    "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0": (1, 0, "A6 00 00 00"),
    "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE": (2, 0, "1F 08 00 00"),
    "FF FF FD 00 01 04 00 55 00 A1 0C": (1, 0, ""),
    "FF FF FD 00 01 06 00 55 00 77 00 C3 69": (1, 0, "77 00"),
    "FF FF FD 00 02 05 00 55 00 24 8B A9": (2, 0, "24"),
}
FAST = {  # Fast Sync Read and Fast Bulk Read
    "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E": (
        ("03", "A6 00 00 00"),
        ("07", "1F 08 00 00"),
        ("04", "FF 03 00 00"),
    ),
    "FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4 00 07 A5 01 24 74 00 04 1F D9 C1": (
        ("03", "A6 00 00 00"),
        ("07", "A5 01"),
        ("04", "1F"),
    ),
}
# DYNAMIXEL Protocol 1.0, the examples of "Instruction Details".
LEGACY_INSTRUCTIONS = {
    "FF FF 01 02 01 FB": (1, 0x01, ""),
    "FF FF 01 04 02 2B 01 CC": (1, 0x02, "2B 01"),
    "FF FF FE 04 03 03 01 F6": (254, 0x03, "03 01"),
    "FF FF 00 02 06 F7": (0, 0x06, ""),
    "FF FF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67": (
        254,
        0x83,
        "1E 04 00 10 00 50 01 01 20 02 60 03",
    ),
    "FF FF FE 09 92 00 02 01 1E 02 02 24 1D": (254, 0x92, "00 02 01 1E 02 02 24"),
}
LEGACY_STATUSES = {
    "FF FF 01 02 00 FC": (1, 0, ""),
    "FF FF 01 03 00 20 DB": (1, 0, "20"),
}


@pytest.mark.parametrize("text", INSTRUCTIONS)
def test_reads_the_instructions_of_the_manual(text: str) -> None:
    number, code, parameters = INSTRUCTIONS[text]
    data = hand(text)
    expected = Instruction(2, number, code, hand(parameters), True, len(data))
    assert Parser2().feed(data) == [expected]


@pytest.mark.parametrize("text", STATUSES)
def test_writes_the_statuses_of_the_manual(text: str) -> None:
    number, error, data = STATUSES[text]
    assert status(number, error, hand(data)) == hand(text)


@pytest.mark.parametrize("text", FAST)
def test_writes_the_fast_statuses_of_the_manual(text: str) -> None:
    answers = [(0, int(number, 16), hand(data)) for number, data in FAST[text]]
    assert fast_status(answers) == hand(text)


@pytest.mark.parametrize("text", LEGACY_INSTRUCTIONS)
def test_reads_the_instructions_of_protocol_1(text: str) -> None:
    number, code, parameters = LEGACY_INSTRUCTIONS[text]
    data = hand(text)
    expected = Instruction(1, number, code, hand(parameters), True, len(data))
    assert Parser1().feed(data) == [expected]


@pytest.mark.parametrize("text", LEGACY_STATUSES)
def test_writes_the_statuses_of_protocol_1(text: str) -> None:
    number, error, data = LEGACY_STATUSES[text]
    assert legacy_status(number, error, hand(data)) == hand(text)


@given(st.binary(max_size=300), st.binary(max_size=300))
def test_crc_is_the_one_of_another_library_and_can_be_continued(one: bytes, two: bytes) -> None:
    assert crc16(one) == other_crc16.umts(one)
    assert crc16(two, crc16(one)) == crc16(one + two)


TRICKY = st.lists(st.sampled_from([0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x55]), max_size=60).map(bytes)


@given(TRICKY)
def test_stuffing_comes_back_as_it_went(data: bytes) -> None:
    assert [(s.number, s.error, s.data) for s in statuses(status(7, 0, data))] == [(7, 0, data)]
    (packet,) = Parser2().feed(instruction(7, 0x03, data))
    assert (packet.parameters, packet.intact) == (data, True)


def test_a_packet_that_is_not_stuffed_is_lost_and_the_next_one_found() -> None:
    body = struct.pack("<BH", 0x03, 104) + struct.pack("<I", 0xFFFDFFFF)
    packet = hand("FF FF FD 00 01") + struct.pack("<H", len(body) + 2) + body
    packet += struct.pack("<H", crc16(packet))
    good = write(1, 116, bytes(4))
    assert [p.parameters for p in Parser2().feed(packet + good)] == [hand("74 00 00 00 00 00")]


@given(st.lists(st.tuples(st.integers(0, 252), TRICKY), min_size=1, max_size=6), st.data())
def test_packets_may_be_cut_anywhere(packets: list[tuple[int, bytes]], data: st.DataObject) -> None:
    stream = b"".join(instruction(number, 0x03, body) for number, body in packets)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    parser = Parser2()
    found = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += parser.feed(stream[start:end])
    assert [(p.id, p.parameters, p.intact) for p in found] == [(n, b, True) for n, b in packets]
    assert found[-1].end == len(stream)


@given(st.binary(max_size=40).filter(lambda noise: b"\xff" not in noise), TRICKY)
def test_noise_before_a_header_costs_nothing(noise: bytes, body: bytes) -> None:
    found = Parser2().feed(noise + instruction(3, 0x02, body))
    assert [(p.id, p.parameters) for p in found] == [(3, body)]


@given(TRICKY, st.data())
def test_a_changed_byte_never_passes_for_an_intact_packet(body: bytes, data: st.DataObject) -> None:
    packet = bytearray(instruction(3, 0x03, body))
    at = data.draw(st.integers(0, len(packet) - 1))
    packet[at] ^= data.draw(st.integers(1, 255))
    assert not [p for p in Parser2().feed(bytes(packet)) if p.intact]


@given(st.integers(0, 252), st.binary(max_size=20), st.data())
def test_protocol_1_may_be_cut_anywhere_and_checks_its_sum(
    number: int, body: bytes, data: st.DataObject
) -> None:
    packet = legacy(number, 0x03, body)
    parser = Parser1()
    cut = data.draw(st.integers(0, len(packet)))
    found = parser.feed(packet[:cut]) + parser.feed(packet[cut:])
    assert [(p.id, p.parameters, p.intact) for p in found] == [(number, body, True)]
    assert checksum(packet[2:-1]) == packet[-1]
    spoilt = packet[:-1] + bytes((packet[-1] ^ 1,))
    assert [p.intact for p in Parser1().feed(spoilt)] == [False]


SERVOS = "1:xm430-w350,2:xl330-m288@50,3:xl430-w250,4:ph54-100-s500,5:ax-12a,6:mx-64-1.0,7:mx-64"
FRAGMENTS = st.one_of(
    st.binary(max_size=30),
    TRICKY,
    st.builds(instruction, st.integers(0, 254), st.integers(0, 255), st.binary(max_size=30)),
    st.builds(
        instruction,
        st.sampled_from([1, 2, 3, 4, 7, 254]),
        st.sampled_from([1, 2, 3, 4, 5, 8, 0x10, 0x20, 0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A]),
        st.one_of(st.binary(max_size=40), TRICKY),
    ),
    st.builds(
        write,
        st.sampled_from([1, 2, 3, 4, 7, 254]),
        st.integers(7, 160),
        st.one_of(st.binary(min_size=1, max_size=8)),
    ),
    st.builds(
        legacy,
        st.sampled_from([5, 6, 254]),
        st.sampled_from([1, 2, 3, 4, 5, 6, 0x83, 0x92]),
        st.binary(max_size=20),
    ),
)


@given(st.lists(FRAGMENTS, max_size=20))
def test_whatever_is_on_the_wire_the_servos_live_and_answer_whole_packets(
    fragments: list[bytes],
) -> None:
    bus = Bus(make_servos(parse_servos(SERVOS), 1_000_000, 0))
    time = 0.0
    for fragment in fragments:
        for parser in (Parser1(), Parser2()):
            for packet in parser.feed(fragment):
                time += 0.3
                for reply in bus.answer(packet, 1_000_000, time):
                    if packet.protocol == 2 and reply.packet and reply.number != 254:
                        assert len(statuses(reply.packet)) == 1
    for servo in bus.servos:
        servo.refresh(time + 1.0)
        assert abs(servo.joint.angle) < 1e9
