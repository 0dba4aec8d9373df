"""OpenIGTLink messages: known answers of the library's own test data, and whatever else may arrive."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.front.openigtlink.bodies import (
    NAMES,
    Body,
    Capability,
    Empty,
    NdArray,
    Position,
    QuaternionTrackingData,
    Reply,
    Sensor,
    Start,
    StatusBody,
    String,
    TooLong,
    Tracked,
    TrackingData,
    Transform,
    decode_body,
    encode_body,
)
from crtk_drivers.front.openigtlink.codec import (
    HEADER,
    LARGEST,
    LARGEST_SKIPPED,
    Damaged,
    Message,
    StreamDecoder,
    crc64,
    encode,
    stamp_of,
    time_of,
)
from crtk_drivers.kit import BadData
from crtk_drivers.samples import vector
from rigs.igtl_peer import checksum, framed

TIME = 0x499602D4
MATRIX = bytes.fromhex(
    "bf7473cd3e4959e6be63dd98be4959e63e12491b3f7852d63e63dd983f7852d6bdc830ae42383660419bc46742383660"
)
METADATA = {"First patient age": "22", "Second patient age": "25"}
EXTENDED = bytes.fromhex("000c00120000002700000001")
PAIRS = bytes.fromhex("0002001100030000000200120003000000 02") + (
    b"First patient age22Second patient age25"
)
SENSOR = bytes.fromhex(
    "060000443e000000000040fe240c7ae147ae40c81cd6c8b4395840934a456d5cfaad405edd3be22e5de1"
    "4028b0fcb4f1e4b43ff3c0ca2a5b1d5d"
)
POSITION = bytes.fromhex("42383660419bc46742383660000000003f13cd3a3f13cd3a3eaaaaab")
TOOLS = b"".join(
    f"Tracker{number}".encode().ljust(20, b"\0") + b"\2\0" + MATRIX for number in range(3)
)


def test_the_checksum_of_the_catalogue() -> None:
    assert crc64(b"123456789") == checksum(b"123456789") == 0x6C40DF5F0B497347


def test_a_transform_of_version_1_is_the_one_of_the_library() -> None:
    body = decode_body("TRANSFORM", MATRIX)
    sent = encode(Message("DeviceName", body, stamp_ns=stamp_of(TIME)))
    assert sent == (
        b"\0\1TRANSFORM\0\0\0DeviceName\0\0\0\0\0\0\0\0\0\0"
        + bytes.fromhex("00000000499602d4 0000000000000030 f6dd2b8eb4df6dd2")
        + MATRIX
    )
    assert isinstance(body, Transform)
    assert np.allclose(body.matrix[:3, 3], (46.0531, 19.4709, 46.0531), atol=1e-4)
    assert body.matrix[0, 1] == pytest.approx(-0.196632)


def test_the_same_of_version_2_has_a_header_of_its_own_and_metadata() -> None:
    message = Message("DeviceName", decode_body("TRANSFORM", MATRIX), metadata=METADATA)
    sent = encode(message, 2, 1)
    assert sent[58:] == EXTENDED + MATRIX + PAIRS
    assert HEADER.unpack_from(sent)[4:] == (0x75, 0xF698F64FDAE266DD)
    (found,) = StreamDecoder().feed(sent)
    assert isinstance(found, Message)
    assert found.version == 2
    assert found.metadata == METADATA
    assert encode_body(found.body) == MATRIX


@pytest.mark.parametrize(
    ("kind", "raw", "crc"),
    [
        ("TRANSFORM", MATRIX, 0xF6DD2B8EB4DF6DD2),
        ("POSITION", POSITION, 0x6BC8D6282B79A3A1),
        ("SENSOR", SENSOR, 0x637B8008662020E7),
        ("TDATA", TOOLS, 0x5C7CEBFD27676877),
    ],
)
def test_bodies_of_the_library_are_read_and_written_as_they_are(
    kind: str, raw: bytes, crc: int
) -> None:
    assert crc64(raw) == crc
    assert encode_body(decode_body(kind, raw)) == raw


@pytest.mark.parametrize(
    ("body", "crc"),
    [
        (String("Welcome to OpenIGTLink"), 0xCEF1B42A701104D4),
        (StatusBody(15, "ACTUATOR_DISABLED", "Actuator A is disabled.", 10), 0x98EE43EED8E431CF),
        (NdArray(np.arange(60.0).reshape(5, 4, 3)), 0x1BE0CE29554F9A92),
    ],
)
def test_what_is_written_has_the_checksum_of_the_librarys(body: Body, crc: int) -> None:
    raw = encode_body(body)
    assert crc64(raw) == crc
    found = decode_body(NAMES[type(body)], raw)
    if isinstance(body, NdArray):
        assert isinstance(found, NdArray)
        assert np.array_equal(found.values, body.values)
    else:
        assert found == body


def test_quaternions_of_tracking_data_are_x_y_z_w_behind_the_position() -> None:
    quarter = np.array([(0, -1, 0, 1), (1, 0, 0, 2), (0, 0, 1, 3), (0, 0, 0, 1)], dtype=float)
    raw = encode_body(QuaternionTrackingData((Tracked("a", quarter),)))
    assert raw[:22] == b"a" + bytes(19) + b"\2\0"
    half = np.sqrt(0.5)
    assert np.allclose(struct.unpack(">7f", raw[22:]), (1, 2, 3, 0, 0, half, half))
    back = decode_body("QTDATA", raw)
    assert isinstance(back, QuaternionTrackingData)
    assert np.allclose(back.tools[0].matrix, quarter, atol=1e-6)


def test_queries_and_their_answers() -> None:
    start = encode_body(Start(50, "Patient"))
    assert len(start) == 36
    assert decode_body("STT_TDATA", start) == Start(50, "Patient")
    assert decode_body("STT_TRANSFOR", b"") == decode_body("GET_STATUS", b"") == Empty()
    assert decode_body("RTS_TDATA", b"\0") == Reply(True)
    assert decode_body("RTS_TDATA", b"\1") == Reply(False)
    assert encode_body(Reply(True)) == b"\0"
    assert encode(Message("", Empty(), "GET_TRANSFORM"))[2:14] == b"GET_TRANSFOR"
    types = Capability(("TRANSFORM", "GET_TRANSFORM"))
    assert decode_body("CAPABILITY", encode_body(types)) == Capability(
        ("TRANSFORM", "GET_TRANSFOR")
    )


def test_positions_may_leave_out_all_or_the_last_of_the_quaternion() -> None:
    for size, orientation in ((12, None), (24, (0.0, 0.57735, 0.57735, 0.57735)), (28, ...)):
        found = decode_body("POSITION", POSITION[:size])
        assert isinstance(found, Position)
        if orientation is None:
            assert found.orientation is None
        elif orientation is not ...:
            assert found.orientation is not None
            assert np.allclose(found.orientation, orientation, atol=1e-3)


def test_names_that_are_too_long_are_refused() -> None:
    message = Message("arm/local/setpoint_cp", String(""))
    with pytest.raises(TooLong, match="21 bytes, and 20"):
        encode(message)
    with pytest.raises(TooLong):
        encode_body(TrackingData((Tracked("a" * 21, np.eye(4)),)))


@given(st.integers(0, 4_000_000_000 * 10**9))
def test_stamps_survive_to_the_nanosecond(stamp: int) -> None:
    assert stamp_of(time_of(stamp)) == stamp


NUMBERS = st.floats(-1e6, 1e6, width=32)
WORDS = st.text(st.characters(max_codepoint=126, min_codepoint=33), max_size=20)


@st.composite
def messages(draw: st.DrawFn) -> Message:
    doubles = st.lists(st.floats(allow_nan=False), max_size=20).map(vector)
    body: Body = draw(
        st.one_of(
            st.builds(String, st.text(st.characters(exclude_categories=("Cs",)), max_size=50)),
            st.builds(StatusBody, st.integers(0, 19), WORDS, WORDS, st.integers(-9, 9)),
            st.builds(Sensor, doubles),
            doubles.map(NdArray),
            st.builds(Position, st.lists(NUMBERS, min_size=3, max_size=3).map(vector), st.none()),
        )
    )
    metadata = draw(st.dictionaries(WORDS, WORDS, max_size=3))
    version = draw(st.sampled_from((1, 2)))
    return Message(
        draw(WORDS), body, stamp_ns=draw(st.integers(0, 10**18)), version=version, metadata=metadata
    )


def pieces(data: bytes, cuts: list[int]) -> Iterator[bytes]:
    marks = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    for begin, end in pairwise(marks):
        yield data[begin:end]


@given(st.lists(messages(), max_size=4), st.lists(st.integers(0, 10**6), max_size=8))
def test_messages_survive_however_they_are_cut(sent: list[Message], cuts: list[int]) -> None:
    data = b"".join(map(encode, sent))
    decoder = StreamDecoder()
    found = [each for piece in pieces(data, cuts) for each in decoder.feed(piece)]
    assert decoder.damaged == decoder.skipped == 0
    assert len(found) == len(sent)
    for before, after in zip(sent, found, strict=True):
        assert isinstance(after, Message)
        assert (after.device, after.stamp_ns) == (before.device, before.stamp_ns)
        assert encode_body(after.body) == encode_body(before.body) or isinstance(after.body, Empty)
        assert after.metadata == (before.metadata if before.version == 2 else {})


@given(messages(), st.integers(58, 10**6), st.integers(1, 255))
def test_a_damaged_body_is_dropped_and_the_next_message_is_whole(
    message: Message, place: int, flip: int
) -> None:
    data = bytearray(encode(message))
    if len(data) == 58:
        return
    data[58 + place % (len(data) - 58)] ^= flip
    after = Message("next", String("whole"))
    found = StreamDecoder().feed(bytes(data) + encode(after))
    assert isinstance(found[0], Damaged)
    assert found[0].is_checksum
    assert isinstance(found[1], Message)
    assert found[1].device == "next"


@given(st.binary(max_size=300))
def test_bytes_that_are_anything_end_in_messages_or_in_bad_data(data: bytes) -> None:
    decoder = StreamDecoder()
    with suppress(BadData):
        decoder.feed(data)


KINDS = (*NAMES.values(), "STT_TDATA", "GET_TDATA", "RTS_TDATA")


@given(st.sampled_from(KINDS), st.binary(max_size=200), st.sampled_from((1, 2)))
def test_a_body_that_is_anything_is_a_message_or_damaged(
    kind: str, body: bytes, version: int
) -> None:
    found = StreamDecoder().feed(
        framed(kind, "a", body, version) + encode(Message("b", String("")))
    )
    assert len(found) == 2
    assert isinstance(found[1], Message)


def test_a_type_that_nobody_knows_is_skipped_without_being_kept() -> None:
    decoder, size = StreamDecoder(), 50_000_000
    head = HEADER.pack(1, b"IMAGE", b"camera", 0, size, 0)
    assert decoder.feed(head + bytes(1000)) == []
    for _ in range(49):
        assert decoder.feed(bytes(1_000_000)) == []
        assert len(decoder._rest) == 0
    found = decoder.feed(bytes(size - 49_001_000) + encode(Message("b", String("on"))))
    assert [each.device for each in found] == ["b"]
    assert decoder.skipped == 1


@pytest.mark.parametrize(
    ("version", "kind", "size"),
    [
        (1, b"STRING", LARGEST + 1),
        (1, b"STRING", (1 << 64) - 1),
        (1, b"IMAGE", LARGEST_SKIPPED + 1),
        (3, b"STRING", 4),
        (0, b"STRING", 4),
    ],
)
def test_sizes_and_versions_of_a_lost_stream_end_it_before_anything_is_kept(
    version: int, kind: bytes, size: int
) -> None:
    with pytest.raises(BadData):
        StreamDecoder().feed(HEADER.pack(version, kind, b"a", 0, size, 0))


@pytest.mark.parametrize(
    "extended",
    [
        struct.pack(">HHII", 12, 2, 0xFFFFFFFF, 0),
        struct.pack(">HHII", 60000, 0, 0, 0),
        struct.pack(">HHII", 0, 0, 0, 0),
        struct.pack(">HHII", 12, 2, 0, 0) + b"\xff\xff",
        struct.pack(">HHII", 12, 10, 0, 0) + struct.pack(">HHHI", 1, 9, 3, 9),
        b"\0\x0c",
    ],
)
def test_sizes_in_a_body_of_version_2_that_contradict_each_other_are_damage(
    extended: bytes,
) -> None:
    (found,) = StreamDecoder().feed(framed("STRING", "a", extended, 2))
    assert isinstance(found, Damaged)
    assert not found.is_checksum
