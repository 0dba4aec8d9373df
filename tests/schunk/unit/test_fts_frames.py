"""Requests, replies and datagrams of an FTS box, without a wire."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crtk_driver_schunk.fts.config import FtsConfig
from crtk_driver_schunk.fts.frames import (
    NAME,
    READY,
    RECORD,
    STATUS,
    UDP_PORT,
    Op,
    Parameter,
    Reply,
    decode,
    parse_reply,
    reply_size,
    request,
)
from crtk_driver_schunk.fts.stream import FtsStream
from crtk_drivers.kit import BadData, FrameDecoder


def replies() -> FrameDecoder[Reply]:
    return FrameDecoder(reply_size, parse_reply)


def test_requests_as_bytes() -> None:
    """As SCHUNK's library sends them."""
    assert request(Op.TARE).hex() == "ffff0000010012"
    assert request(Op.START).hex() == "ffff0000010040"
    assert request(Op.GET, NAME).hex() == "ffff00000400f0010000"
    assert request(Op.SET, UDP_PORT, struct.pack("<H", 54843)).hex() == "ffff00000600f13310003bd6"


WHOLE = bytes.fromhex("ffff0300020040" + "00") + bytes.fromhex("ffff04000700f0000100004654")


@given(st.lists(st.integers(0, len(WHOLE)), max_size=8))
def test_replies_cut_anywhere_are_the_same(cuts: list[int]) -> None:
    decoder, found = replies(), []
    places = sorted({0, *cuts, len(WHOLE)})
    for begin, end in zip(places, [*places[1:], len(WHOLE)], strict=True):
        found += decoder.feed(WHOLE[begin:end])
    assert found == [Reply(0x40, 0), Reply(0xF0, 0, Parameter(1, 0), b"FT")]


@given(st.binary(max_size=80))
def test_any_bytes_are_replies_or_refused(data: bytes) -> None:
    decoder = replies()
    try:
        found = decoder.feed(data)
    except BadData:
        return
    assert all(isinstance(reply, Reply) for reply in found)


def datagram(counter: int, load: tuple[float, ...] = (0.0,) * 6, status: int = READY) -> bytes:
    head = struct.pack("<2sHHB", b"\xff\xff", counter, 29, counter & 0xFF)
    return head + struct.pack("<I6f", status, *load)


def slots(datagrams: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
    found = np.zeros((len(datagrams), 64), np.uint8)
    for row, data in zip(found, datagrams, strict=True):
        row[: len(data)] = np.frombuffer(data, np.uint8)
    return found, np.array([len(data) for data in datagrams], np.uint32)


def test_datagrams_as_values() -> None:
    load = (1.0, -2.0, 30.0, 0.1, -0.2, 0.3)
    records, kept = decode(*slots([datagram(7, load), datagram(8, load, READY | 1 << 4)]))
    assert kept is None
    assert records["counter"].tolist() == [7, 8]
    assert records["load"][0] == pytest.approx(load)
    assert not STATUS.is_error(records["status"]).any()
    assert STATUS.is_saturated(records["status"]).tolist() == [False, True]


def test_what_is_no_measurement_is_left_out() -> None:
    good = datagram(1)
    bad = [good[:-1], good + b"\0", b"", b"\0" + good[1:], datagram(2, (float("nan"),) * 6)]
    records, kept = decode(*slots([*bad, good]))
    assert kept is not None
    assert kept.tolist() == [False] * 5 + [True]
    assert records["counter"].tolist() == [1]


@given(arrays(np.uint8, (5, RECORD.itemsize)), arrays(np.uint32, 5, elements=st.integers(0, 99)))
def test_any_datagrams_are_finite_or_none(data: np.ndarray, lengths: np.ndarray) -> None:
    before = data.copy()
    records, _ = decode(data, lengths)
    assert np.isfinite(records["load"]).all()
    assert (data == before).all(), "what was received is left as it is"


@pytest.mark.parametrize(
    ("word", "text"),
    [
        (0, "not ready"),
        (READY | 1 << 1, "invalid"),
        (READY | 1 << 3, "hardware"),
        (READY | 1 << 2, "temperature"),
        (READY | 1 << 5, "user"),
    ],
)
def test_status_words_in_words(word: int, text: str) -> None:
    assert text in ", ".join(STATUS.texts(word ^ READY))
    assert STATUS.texts(READY ^ READY) == ()


@given(st.integers(0, 0xFFFF), st.lists(st.integers(-300, 300), min_size=1, max_size=30))
def test_counters_are_numbered_through_their_wraps(first: int, steps: list[int]) -> None:
    stream = FtsStream(FtsConfig(), lambda: False)
    true = np.cumsum([1, *steps]) + first
    counters = (true % 0x10000).astype(np.uint16)
    cut = len(counters) // 2 or 1
    numbers = np.concatenate(
        [stream._numbered(part) for part in (counters[:cut], counters[cut:]) if len(part)]
    )
    assert (numbers.astype(np.int64) - int(numbers[0])).astype(np.int32).tolist() == (
        true - true[0]
    ).tolist()
    assert numbers[0] == 1
