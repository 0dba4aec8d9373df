"""Commands and replies: bytes that are known, and bytes that are hostile."""

import struct
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ndi.codec import (
    LONGEST_BINARY,
    LONGEST_TEXT,
    Reply,
    command,
    error_text,
    reply_decoder,
)
from crtk_driver_ndi.crc import crc16
from crtk_drivers.kit import BadData
from crtk_drivers.kit.crc16 import reflected_crc16

COMMANDS = {
    "INIT:": "E3A5",
    "TX:0801": "C19B",
    "BX:0801": "00EC",
    "PHSR:00": "20FF",
    "PENA:01D": "6D3B",
    "TSTART:80": "1B0B",
}
REPLIES = {"OKAY": "A896", "ERROR0C": "4E42", "WARNING06": "018D", "RESET": "BE6F"}

BX = bytes.fromhex(
    "c4a537003b23 02 01010000803f000000000000000000000000000020410000a04100007ac40000003e"
    "3100000007000000 02023100000007000000 000069c5"
)
STREAM = (
    b"OKAYA896\r"
    + BX
    + b"RESETBE6F\r"
    + b"\xc8\xa5"
    + struct.pack("<I", 3)
    + b"\r\r\r"
    + b"ERROR0C4E42\r"
)
MEANT = [
    Reply("OKAY"),
    Reply(body=BX[6:-2]),
    Reply("RESET"),
    Reply(body=b"\r\r\r"),
    Reply("ERROR0C"),
]


@pytest.mark.parametrize(("text", "check"), COMMANDS.items())
def test_commands_have_the_known_checks(text: str, check: str) -> None:
    assert command(text) == f"{text}{check}\r".encode()


@pytest.mark.parametrize(("text", "check"), REPLIES.items())
def test_known_replies_are_read(text: str, check: str) -> None:
    assert reply_decoder().feed(f"{text}{check}\r".encode()) == [Reply(text)]


def test_what_a_reply_means() -> None:
    assert Reply("ERROR0C").error == 0x0C
    assert Reply("WARNING06").error is None
    assert Reply("WARNING06").warning == 6
    assert Reply("RESET").is_reset
    assert Reply("ERROR").error is None
    assert Reply("ERRORxx").error is None
    assert error_text(0x0C).startswith("ERROR0C: not possible in the present mode")
    assert "no known meaning" in error_text(0xEE)


@given(st.binary(max_size=300))
def test_both_ways_to_the_check_agree(data: bytes) -> None:
    assert reflected_crc16(data) == crc16(data)


@given(st.lists(st.integers(0, len(STREAM)), max_size=8))
def test_where_the_stream_is_cut_does_not_matter(cuts: list[int]) -> None:
    decoder, found = reply_decoder(), []
    edges = [0, *sorted(cuts), len(STREAM)]
    for begin, end in pairwise(edges):
        found += decoder.feed(STREAM[begin:end])
    assert found == MEANT


@given(st.integers(0, len(BX) - 1), st.integers(1, 255))
def test_no_changed_byte_of_a_binary_reply_goes_unseen(at: int, change: int) -> None:
    damaged = bytearray(BX)
    damaged[at] ^= change
    try:
        found = reply_decoder().feed(bytes(damaged))
    except BadData:
        return
    assert Reply(body=BX[6:-2]) not in found
    assert not any(reply.body for reply in found) or damaged[:2] == b"\xc8\xa5"


@given(st.binary(max_size=400))
def test_hostile_bytes_are_refused_or_waited_for(data: bytes) -> None:
    try:
        found = reply_decoder().feed(data)
    except BadData:
        return
    assert all(isinstance(reply, Reply) for reply in found)


@pytest.mark.parametrize("length", [LONGEST_BINARY + 1, 0x7FFFFFFF, 0xFFFFFFFF])
def test_a_long_reply_is_refused_by_its_length_before_it_comes(length: int) -> None:
    with pytest.raises(BadData, match=f"{length} bytes"):
        reply_decoder().feed(struct.pack("<HI", 0xA5C8, length))


def test_a_text_without_end_is_refused() -> None:
    decoder = reply_decoder()
    assert decoder.feed(b"A" * LONGEST_TEXT) == []
    with pytest.raises(BadData, match="without an end"):
        decoder.feed(b"AA")


@pytest.mark.parametrize(
    "reply", [b"\r", b"OK\r", b"OKAYA897\r", b"OKAY\xff\xff\xff\xff\r", b"OKAYwxyz\r"]
)
def test_a_text_whose_check_is_wrong_is_refused(reply: bytes) -> None:
    with pytest.raises(BadData):
        reply_decoder().feed(reply)
