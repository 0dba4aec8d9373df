"""Packets of IEEE 1394: known bytes, and what is none."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_driver_dvrk import packets
from crtk_driver_dvrk.packets import Extra, Reply, Tcode
from rigs.examples import examples

QUADLETS = st.integers(0, 0xFFFFFFFF)
NODES = st.integers(0, 63)
LABELS = st.integers(0, 63)

EXTRA = bytes.fromhex("00 07 00 00 03 84 09 60")
"""No flag, generation 7."""


def quadlet_reply(value: int, *, node: int = 1, label: int = 5, crc: int | None = None) -> bytes:
    """Return what a board answers to the question for a register."""
    packet = bytes.fromhex("ff d0") + (label << 10 | Tcode.QUADLET_RESPONSE << 4).to_bytes(2)
    packet += (0xFFC0 | node).to_bytes(2) + bytes(6) + value.to_bytes(4)
    sealed = packets.crc(packet) if crc is None else crc
    return packet + sealed.to_bytes(4) + EXTRA


def block_reply(values: list[int], *, sealed: bool = True) -> bytes:
    """Return what a board answers to the question for a block."""
    data = b"".join(value.to_bytes(4) for value in values)
    head = bytes.fromhex("ff d0 14 70 ff c1 00 00 00 00 00 00") + len(data).to_bytes(2) + bytes(2)
    first, second = (packets.crc(head), packets.crc(data)) if sealed else (0, 0)
    return head + first.to_bytes(4) + data + second.to_bytes(4) + EXTRA


def test_the_crc_is_that_of_crc_32_bzip2() -> None:
    """Its check value, of the catalogue of CRCs."""
    assert packets.crc(b"123456789") == 0xFC891918


def test_a_question_for_a_register_has_the_bytes_of_dvrks_library() -> None:
    """Register 4 of node 63, label 2, not sent on: as JHU's own program sent it."""
    packet = packets.read_quadlet(63, 4, 2)
    assert packets.datagram(packet, 0, forward=False) == bytes.fromhex(
        "01 00 ff ff 08 40 ff d0 00 00 00 00 00 04 58 ff b1 82"
    )


def test_a_question_for_a_block_tells_its_bytes() -> None:
    packet = packets.read_block(3, 0, 32, 9)
    assert packet[:16] == bytes.fromhex("ff c3 24 50 ff d0 00 00 00 00 00 00 00 80 00 00")
    assert packet[16:] == packets.crc(packet[:16]).to_bytes(4)


def test_a_write_has_its_value_before_the_crc() -> None:
    packet = packets.write_quadlet(63, 11, 0x6400FEA9, 1)
    assert packet[:16] == bytes.fromhex("ff ff 04 00 ff d0 00 00 00 00 00 0b 64 00 fe a9")
    assert len(packet) == 20
    assert packets.datagram(packet, 0x1FE, forward=True)[:2] == bytes.fromhex("00 fe")


def test_a_register_is_read_with_the_extra_bytes() -> None:
    assert packets.parse(quadlet_reply(0x514C4131)) == Reply(1, 5, (0x514C4131,), Extra(0, 7))


def test_a_board_leaves_the_crc_of_its_own_replies_at_0() -> None:
    assert packets.parse(quadlet_reply(8, crc=0)) == Reply(1, 5, (8,), Extra(0, 7))
    assert packets.parse(block_reply([1, 2], sealed=False)) == Reply(1, 5, (1, 2), Extra(0, 7))


def test_eight_bytes_alone_are_what_the_board_says_in_place_of_an_answer() -> None:
    assert packets.parse(bytes([packets.DROPPED, 9]) + bytes(6)) == Extra(packets.DROPPED, 9)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no reply"),
        (bytes(7), "no reply"),
        (bytes(20), "no reply"),
        (quadlet_reply(8, crc=1), "CRC"),
        (quadlet_reply(8) + bytes(4), "24 bytes"),
        (block_reply([1, 2])[:-12] + bytes(8), "comes in"),
        (quadlet_reply(8)[:3] + b"\x40" + quadlet_reply(8)[4:], "transaction code 4"),
        (quadlet_reply(8)[:6] + b"\x40" + quadlet_reply(8)[7:], "CRC"),
    ],
)
def test_what_is_no_reply_is_refused(data: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        packets.parse(data)


def test_a_node_that_refuses_is_no_answer() -> None:
    good = quadlet_reply(8, crc=0)
    with pytest.raises(ValueError, match="response code 4"):
        packets.parse(good[:6] + b"\x40" + good[7:])


@settings(max_examples=examples(40))
@given(QUADLETS, NODES, LABELS)
def test_a_register_comes_back_as_it_was(value: int, node: int, label: int) -> None:
    found = packets.parse(quadlet_reply(value, node=node, label=label))
    assert found == Reply(node, label, (value,), Extra(0, 7))


@settings(max_examples=examples(40))
@given(st.lists(QUADLETS, max_size=40), st.booleans())
def test_a_block_comes_back_as_it_was(values: list[int], sealed: bool) -> None:
    found = packets.parse(block_reply(values, sealed=sealed))
    assert isinstance(found, Reply)
    assert found.quadlets == tuple(values)


@settings(max_examples=examples(40))
@given(st.lists(QUADLETS, min_size=1, max_size=32), st.data())
def test_a_changed_byte_before_the_extra_ones_is_found(
    values: list[int], data: st.DataObject
) -> None:
    good = block_reply(values)
    at = data.draw(st.integers(0, len(good) - packets.EXTRA - 1))
    change = data.draw(st.integers(1, 255))
    bad = good[:at] + bytes([good[at] ^ change]) + good[at + 1 :]
    with contextlib.suppress(ValueError):
        # A changed CRC of 0 is as none; so is nothing else.
        assert packets.parse(bad) == packets.parse(good)
        assert 0 in (packets.crc(bad[:16]), packets.crc(bad[20:-12]))


@settings(max_examples=examples(40))
@given(st.lists(QUADLETS, max_size=8), st.data())
def test_what_is_cut_is_no_reply(values: list[int], data: st.DataObject) -> None:
    good = block_reply(values)
    cut = data.draw(st.integers(0, len(good) - 1))
    try:
        found = packets.parse(good[:cut])
    except ValueError:
        return
    assert isinstance(found, Extra)
    assert cut == packets.EXTRA


@settings(max_examples=examples(40))
@given(st.binary(max_size=200))
def test_random_bytes_raise_nothing_else(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        packets.parse(data)
