"""Answers of a controller, cut anywhere."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_galil.replies import LONGEST, Replies, Reply, numbers
from crtk_drivers.kit import BadData

STREAM = b" 1, -2, 3\r\n::?DMC4143 Rev 1.3d\r\n:22 Begin not possible due to limit switch\r\n:"
REPLIES = [
    Reply("1, -2, 3", True),
    Reply("", True),
    Reply("", False),
    Reply("DMC4143 Rev 1.3d", True),
    Reply("22 Begin not possible due to limit switch", True),
]


@given(st.lists(st.integers(0, len(STREAM)), max_size=8))
def test_answers_are_the_same_wherever_they_are_cut(cuts: list[int]) -> None:
    ends = [0, *sorted(cuts), len(STREAM)]
    decoder = Replies()
    found = [reply for begin, end in pairwise(ends) for reply in decoder.feed(STREAM[begin:end])]
    assert found == REPLIES


def test_what_a_program_writes_is_kept_apart() -> None:
    decoder = Replies()
    said = bytes(byte | 0x80 for byte in b"HELLO:\r\n")
    assert decoder.feed(b" 5" + said + b"\r\n:") == [Reply("5", True)]
    assert decoder.said == len(said)


@given(st.binary(max_size=300))
def test_random_bytes_are_answers_or_none(data: bytes) -> None:
    for reply in Replies().feed(data):
        assert ":" not in reply.text


def test_no_end_is_an_error() -> None:
    with pytest.raises(BadData, match="without an end"):
        Replies().feed(b"x" * (LONGEST + 1))


def test_numbers() -> None:
    assert numbers(" 0, -1.5, 3") == [0.0, -1.5, 3.0]
    with pytest.raises(ValueError, match="could not convert"):
        numbers("4 axes")
