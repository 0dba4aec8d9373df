"""HTTP replies in pieces, in chunks, until the end of a connection, and what is none."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_schunk.gripper.http_link import HttpLink
from crtk_driver_schunk.gripper.http_replies import LONGEST, Replies
from crtk_driver_schunk.gripper.link import Question
from crtk_drivers.errors import ProtocolError
from crtk_drivers.kit import TcpTransport

BODY = b'["800000800000A25800000000000000EF"]'
PLAIN = b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%b" % (len(BODY), BODY)
CHUNKED = (
    b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
    b"9\r\n%b\r\n%x\r\n%b\r\n0\r\n\r\n" % (BODY[:9], len(BODY) - 9, BODY[9:])
)
UNTIL_END = b"HTTP/1.0 200 OK\r\nServer: x\r\n\r\n" + BODY


@given(st.sampled_from([PLAIN, CHUNKED]), st.lists(st.integers(0, 200), max_size=6))
def test_cut_anywhere_it_is_the_same(reply: bytes, cuts: list[int]) -> None:
    replies, found = Replies(), []
    places = sorted({0, *(cut % len(reply) for cut in cuts), len(reply)})
    for begin, end in pairwise(places):
        body = replies.feed(reply[begin:end])
        found += [body] if body is not None else []
        assert (body is not None) is (end == len(reply))
    assert found == [BODY]
    assert not replies.closes


def test_two_at_once_are_two() -> None:
    replies = Replies()
    assert replies.feed(PLAIN + CHUNKED) == BODY
    assert replies.feed(b"") == BODY
    assert replies.feed(b"") is None


def test_one_without_a_length_ends_with_the_connection() -> None:
    replies = Replies()
    assert replies.feed(UNTIL_END) is None
    assert replies.feed(b"", ended=True) == BODY
    assert replies.closes


@pytest.mark.parametrize(
    "data",
    [
        b"HTTP/1.1 500 Oops\r\nContent-Length: 0\r\n\r\n",
        b"HTTP/1.1 404 Not Found\r\nContent-Length: 2\r\n\r\n{}",
        b"\x09\x03\x02\x31\x00\r\n\r\n",
        b"SSH-2.0-dropbear\r\n\r\n",
        b"x" * (LONGEST + 1),
    ],
    ids=["500", "404", "bytes", "another server", "no end"],
)
def test_what_is_no_success_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"HTTP|bytes as one"):
        Replies().feed(data)


@given(st.binary(max_size=300), st.booleans())
def test_any_bytes_are_a_reply_or_refused(data: bytes, ended: bool) -> None:
    try:
        body = Replies().feed(data, ended=ended)
    except ValueError:
        return
    assert body is None or isinstance(body, bytes)


def test_a_body_that_is_deep_is_no_value() -> None:
    link = HttpLink(lambda: TcpTransport("127.0.0.1", 1), 1.0)
    with pytest.raises(ProtocolError, match="it sent"):
        link._understood(Question(1, 2), b"[" * 60_000)
