"""Frames as bytes: how long they are on the wire, which of two wins, what cannot be sent."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.can import frames

STANDARD = st.integers(0, 0x7FF)
EXTENDED = st.integers(0, 0x1FFFFFFF).map(lambda number: number | frames.EXTENDED)
CAN_IDS = st.one_of(STANDARD, EXTENDED)
DATA = st.binary(max_size=8)


def bits_of(number, width):
    return [number >> shift & 1 for shift in reversed(range(width))]


def bits_on_the_wire(can_id, data, length):
    """The frame bit by bit, as ISO 11898-1 draws it: an oracle that shares no table with the code."""
    remote = 1 if can_id & frames.REMOTE else 0
    number = can_id & 0x1FFFFFFF
    bits = [0]
    if can_id & frames.EXTENDED:
        bits += [*bits_of(number >> 18, 11), 1, 1, *bits_of(number & 0x3FFFF, 18), remote, 0, 0]
    else:
        bits += [*bits_of(number, 11), remote, 0, 0]
    bits += bits_of(length, 4)
    if not remote:
        for byte in data:
            bits += bits_of(byte, 8)
    crc = 0
    for bit in bits:
        crc, feedback = crc << 1 & 0x7FFF, bit ^ crc >> 14
        if feedback:
            crc ^= 0x4599
    bits += bits_of(crc, 15)
    stuffed, run, last = [], 0, None
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        stuffed.append(bit)
        if run == 5:
            last, run = 1 - bit, 1
            stuffed.append(last)
    return len(stuffed) + 1 + 2 + 7 + 3  # CRC delimiter, ACK, end of frame, intermission


@given(CAN_IDS, DATA)
def test_the_exact_length_is_that_of_the_frame_bit_by_bit(can_id, data):
    assert frames.exact_bits(frames.pack(can_id, data)) == bits_on_the_wire(can_id, data, len(data))


@given(CAN_IDS, st.integers(0, 8))
def test_a_remote_frame_has_a_length_but_no_data(can_id, length):
    raw = frames.pack(can_id | frames.REMOTE, b"", length)
    assert frames.exact_bits(raw) == bits_on_the_wire(can_id | frames.REMOTE, b"", length)


@given(CAN_IDS, DATA)
def test_stuffing_lies_between_none_and_the_worst_case(can_id, data):
    raw = frames.pack(can_id, data)
    assert frames.plain_bits(raw) <= frames.exact_bits(raw) <= frames.worst_bits(raw)


def test_textbook_lengths():
    eight = bytes(8)
    assert frames.plain_bits(frames.pack(0x123, eight)) == 111
    assert frames.worst_bits(frames.pack(0x123, eight)) == 135
    assert frames.plain_bits(frames.pack(0x123 | frames.EXTENDED, eight)) == 131
    assert frames.worst_bits(frames.pack(0x123 | frames.EXTENDED, eight)) == 160
    assert frames.plain_bits(frames.pack(0x123)) == 47


def arbitration_field(can_id):
    """The bits that decide, in the order in which they are sent."""
    remote = 1 if can_id & frames.REMOTE else 0
    number = can_id & 0x1FFFFFFF
    if can_id & frames.EXTENDED:
        return [*bits_of(number >> 18, 11), 1, 1, *bits_of(number & 0x3FFFF, 18), remote]
    return [*bits_of(number, 11), remote, 0]


@given(
    CAN_IDS.flatmap(lambda can_id: st.sampled_from([can_id, can_id | frames.REMOTE])),
    CAN_IDS.flatmap(lambda can_id: st.sampled_from([can_id, can_id | frames.REMOTE])),
)
def test_the_first_dominant_bit_wins(one, other):
    wins = arbitration_field(one) < arbitration_field(other)
    assert (frames.priority(one) < frames.priority(other)) == wins


def test_data_wins_against_remote_and_standard_against_extended():
    standard, extended = 0x123, 0x123 << 18 | frames.EXTENDED
    order = [standard, standard | frames.REMOTE, extended, extended | frames.REMOTE]
    assert sorted(set(order), key=frames.priority) == order


@pytest.mark.parametrize(
    ("raw", "complaint"),
    [
        (bytes(15), "has 16 bytes"),
        (frames.LAYOUT.pack(0x123, 9, bytes(8)), "at most 8"),
        (frames.LAYOUT.pack(0x800, 0, bytes(8)), "extended format"),
        (frames.LAYOUT.pack(0x123 | frames.ERROR, 8, bytes(8)), "error frame"),
    ],
)
def test_what_no_interface_would_send_is_refused(raw, complaint):
    assert complaint in frames.fault_of(raw)


@given(CAN_IDS, DATA)
def test_frames_survive_packing(can_id, data):
    raw = frames.pack(can_id, data)
    assert frames.fault_of(raw) is None
    assert frames.unpack(raw) == (can_id, data)
