"""Replies of a whole group at once: the manual's fast reads, damage, and what only looks right."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.group_replies import FastReply, PlainReplies, Whole
from rigs.dynamixel_packets import NASTY, crc, fast_status2, status2

# E-manual, "Fast Sync Read" and "Fast Bulk Read": values and CRCs of the examples.
FAST_SYNC = (
    "FF FF FD 00 FE 19 00 55"
    " 00 03 A6 00 00 00 84 08"
    " 00 07 1F 08 00 00 16 CA"
    " 00 04 FF 03 00 00 D1 9E"
)
FAST_BULK = "FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4 00 07 A5 01 24 74 00 04 1F D9 C1"


@pytest.mark.parametrize(
    ("text", "blocks", "data"),
    [
        (FAST_SYNC, [(3, 4), (7, 4), (4, 4)], ("A6000000", "1F080000", "FF030000")),
        (FAST_BULK, [(3, 4), (7, 2), (4, 1)], ("A6000000", "A501", "1F")),
    ],
)
def test_fast_replies_of_the_manual(text, blocks, data):
    reply = FastReply(blocks)
    packet = bytes.fromhex(text)
    values = tuple(bytes.fromhex(value) for value in data)
    assert reply.size == len(packet)
    assert packet.startswith(reply.prefix)
    assert reply.whole(packet) == Whole(values, (0,) * len(blocks))
    ids = [id for id, _ in blocks]
    assert reply.blocks(packet) == [
        Status(id, 0, False, value) for id, value in zip(ids, values, strict=True)
    ]


GROUPS = st.lists(
    st.tuples(st.integers(0, 252), st.sampled_from([0, 0x80]), st.integers(1, 12)),
    min_size=1,
    max_size=6,
    unique_by=lambda item: item[0],
)


@st.composite
def groups(draw):
    """(id, error, data) of several servos."""

    def data(length):
        nasty = draw(NASTY)
        return (nasty * length)[:length] if nasty else bytes(length)

    return [(id, error, data(length)) for id, error, length in draw(GROUPS)]


@given(group=groups())
def test_fast_replies_need_no_stuffing(group):
    reply = FastReply([(id, len(data)) for id, _, data in group])
    packet = fast_status2(group)
    assert reply.whole(packet) == Whole(
        tuple(data for _, _, data in group), tuple(error for _, error, _ in group)
    )


@given(group=groups(), data=st.data())
def test_a_damaged_block_costs_only_those_that_it_reaches(group, data):
    """One byte reaches the block that it is in, and the next one if it belongs to a CRC."""
    reply = FastReply([(id, len(values)) for id, _, values in group])
    packet = bytearray(fast_status2(group))
    at = data.draw(st.integers(8, len(packet) - 1))
    packet[at] ^= data.draw(st.integers(1, 255))
    ends = [8 + sum(len(v) + 4 for _, _, v in group[: k + 1]) for k in range(len(group))]
    hit = next(k for k, end in enumerate(ends) if at < end)
    lost = {hit, hit + 1} if at >= ends[hit] - 2 else {hit}
    assert reply.whole(bytes(packet)) is None
    for index, block in enumerate(reply.blocks(bytes(packet))):
        id, error, values = group[index]
        assert block == (None if index in lost else Status(id, 0, error != 0, values))


@given(group=groups(), data=st.data())
def test_blocks_before_the_end_of_a_truncated_reply_count(group, data):
    reply = FastReply([(id, len(values)) for id, _, values in group])
    packet = fast_status2(group)
    cut = data.draw(st.integers(8, len(packet) - 1))
    blocks = reply.blocks(packet[:cut])
    start = 8
    for block, (id, error, values) in zip(blocks, group, strict=True):
        start += len(values) + 4
        assert block == (Status(id, 0, error != 0, values) if start <= cut else None)


def test_a_block_of_another_servo_is_not_taken():
    reply = FastReply([(3, 2), (4, 2)])
    packet = fast_status2([(3, 0, b"ab"), (5, 0, b"cd")])
    assert reply.whole(packet) is None
    assert reply.blocks(packet) == [Status(3, 0, False, b"ab"), None]


def test_an_error_number_in_a_fast_reply_is_told():
    reply = FastReply([(3, 2), (4, 2)])
    packet = fast_status2([(3, 0x80, b"ab"), (4, 0x07, b"\0\0")])
    assert reply.whole(packet) is None
    assert reply.blocks(packet) == [Status(3, 0, True, b"ab"), Status(4, 7, False, b"\0\0")]


@given(group=groups())
def test_plain_replies_are_taken_at_once_unless_something_is_stuffed(group):
    replies = PlainReplies([(id, len(data)) for id, _, data in group])
    stream = b"".join(status2(id, data, error) for id, error, data in group)
    if len(stream) != replies.size:
        return
    whole = replies.whole(stream)
    if any(b"\xff\xff\xfd" in data for _, _, data in group):
        assert whole is None
    else:
        # A CRC may end like a header; then it is left to the parser.
        assert whole in (
            None,
            Whole(tuple(d for _, _, d in group), tuple(e for _, e, _ in group)),
        )
        assert whole is not None or stream.count(b"\xff\xff\xfd") > len(group)


def test_plain_replies_that_are_usual_are_taken_at_once():
    replies = PlainReplies([(1, 4), (2, 4)])
    stream = status2(1, b"\x01\x02\x03\x04") + status2(2, b"\x05\x06\x07\x08", 0x80)
    assert replies.whole(stream) == Whole((b"\x01\x02\x03\x04", b"\x05\x06\x07\x08"), (0, 0x80))


def test_a_stuffed_reply_of_the_expected_size_is_not_taken_as_it_is():
    """Nine bytes of which one is stuffed are as long as ten: of an earlier request, perhaps."""
    replies = PlainReplies([(1, 10)])
    stream = status2(1, b"\xff\xff\xfd123456")
    assert len(stream) == replies.size
    assert replies.whole(stream) is None


@given(group=groups(), data=st.data())
def test_damage_is_never_taken(group, data):
    replies = PlainReplies([(id, len(values)) for id, _, values in group])
    stream = bytearray(b"".join(status2(id, values, error) for id, error, values in group))
    at = data.draw(st.integers(0, len(stream) - 1))
    stream[at] ^= 1 << data.draw(st.integers(0, 7))
    if len(stream) == replies.size:
        assert replies.whole(bytes(stream)) is None


def test_what_has_come_so_far_is_looked_at():
    replies = PlainReplies([(1, 4), (2, 4), (3, 4)])
    stream = b"".join(status2(id, b"abcd") for id in (1, 2, 3))
    assert all(replies.fits(stream[:cut]) for cut in range(len(stream)))
    assert not replies.fits(stream[15:30])  # number 1 is missing
    assert not replies.fits(stream[:15] + stream[30:])  # number 2 is missing
    assert not replies.fits(b"noise")
    fast = FastReply([(1, 4), (2, 4)])
    reply = fast_status2([(1, 0, b"abcd"), (2, 0, b"efgh")])
    assert all(fast.fits(reply[:cut]) for cut in range(len(reply)))
    assert not fast.fits(b"\x00" + reply)


def test_the_independent_crc_is_the_one_of_the_manual():
    packet = bytes.fromhex(FAST_SYNC)
    assert crc(packet[:14]) == packet[14:16]
