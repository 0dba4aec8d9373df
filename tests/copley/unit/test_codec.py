"""Commands as the manual writes them, and answers cut and damaged anywhere."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_copley import codec
from crtk_driver_copley.codec import END, LONGEST, Reply, address, is_question, parse
from crtk_drivers.kit import BadData, LineDecoder

STREAM = b"v 1234567\rok\rv 32 0\re 33\rr 15\rv -5\r"
REPLIES = [
    Reply("v", (1234567,), "v 1234567"),
    Reply("ok", (), "ok"),
    Reply("v", (32, 0), "v 32 0"),
    Reply("e", (33,), "e 33"),
    Reply("r", (15,), "r 15"),
    Reply("v", (-5,), "v -5"),
]


def decoder() -> LineDecoder[Reply]:
    return LineDecoder(parse, end=END, longest=LONGEST, errors="replace", strict=True)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (codec.get("", 0x32), "g r0x32"),
        (codec.get(address(2, "B"), 0x0C), "2 .B g r0x0c"),
        (codec.put("", 0x90, 115200), "s r0x90 115200"),
        (codec.put("", 0x24, 21), "s r0x24 21"),
        (codec.put(address(3, None), 0x115, 30, -1200, 55), "3 s r0x115 30 -1200 55"),
        (codec.update(address(0, "A")), ".A t 1"),
        (codec.abort(""), "t 0"),
        (codec.home("1 "), "1 t 2"),
    ],
)
def test_commands_are_as_in_the_manual(text: str, wanted: str) -> None:
    assert text == wanted
    assert is_question(text) == ("g r" in wanted)


@given(st.lists(st.integers(0, len(STREAM)), max_size=8))
def test_answers_are_the_same_wherever_they_are_cut(cuts: list[int]) -> None:
    ends = [0, *sorted(cuts), len(STREAM)]
    one = decoder()
    assert [r for begin, end in pairwise(ends) for r in one.feed(STREAM[begin:end])] == REPLIES


@pytest.mark.parametrize(
    "line",
    ["", "v", "v x", "v 12a", "e", "okay", "o", "k", "v 1  2", "w 5", "v 123456789012", "v 1.5"],
)
def test_what_is_no_answer_has_no_kind(line: str) -> None:
    assert parse(line).kind == ""
    assert parse(line).error == 0


@given(st.binary(max_size=LONGEST))
def test_random_bytes_are_answers_or_none(data: bytes) -> None:
    for reply in decoder().feed(data):
        assert reply.kind in ("", "ok", "v", "r", "e")
        assert bool(reply.values) == (reply.kind in ("v", "r", "e"))


@given(st.sampled_from(REPLIES), st.integers(0, 20), st.sampled_from((0x40, 0x80)))
def test_a_damaged_digit_is_no_number(reply: Reply, place: int, bit: int) -> None:
    """With one of these bits changed a digit is none; with a low one it is another, which nothing shows."""
    data = bytearray(reply.text.encode())
    data[place % len(data)] ^= bit
    found = decoder().feed(bytes(data) + END)
    assert all(other.kind == "" for other in found)


def test_no_end_is_an_error() -> None:
    with pytest.raises(BadData, match="without an end"):
        decoder().feed(b"v" * (LONGEST + 1))


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=3))
def test_values_come_back_as_they_were_sent(values: list[int]) -> None:
    assert parse(f"v {' '.join(map(str, values))}").values == tuple(values)
