"""The primary interface without I/O: packets written here from UR's guide, whole, split and broken."""

import itertools
import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ur.primary import MessageReader, PacketReader, PrimaryError

CHECKSUM = (0xDEADBEEF, 2, 3, 4, 5, 0xFFFFFFFF)
THETA = (0.001, -0.35, 0.35, -0.002, 0.0, 0.0)
A = (1e-5, -0.4251, -0.3921, 2e-5, -3e-5, 0.0)
D = (0.1626, 372.7, -372.6, 0.0333, 0.0998, 0.0995)
ALPHA = (math.pi / 2, 0.001, -0.002, math.pi / 2, -math.pi / 2, 0.0)


def framed(kind: int, body: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(body), kind) + body


VERSION = framed(
    20,
    struct.pack(">Qbb", 123456, -2, 3)
    + b"\x09URControl"
    + struct.pack(">BBii", 5, 12, 4, 1101661)
    + b"01-01-2025, 00:00:00",
)
KINEMATICS = framed(
    5, struct.pack(">6I24d", *CHECKSUM, *THETA, *A, *D, *ALPHA) + struct.pack(">I", 1)
)
CONFIGURATION = framed(6, bytes(8 * (12 + 12 + 5 + 24)) + struct.pack(">4i", 3, 3, 7, 1))
OTHER_PART = framed(1, bytes(251))
STATE = framed(16, OTHER_PART + KINEMATICS + CONFIGURATION)
TEXT = framed(20, struct.pack(">Qbb", 1, -3, 0) + b"hello")
STREAM = VERSION + TEXT + framed(99, b"?") + STATE


def read(*pieces: bytes) -> PacketReader:
    reader = PacketReader()
    for piece in pieces:
        reader.feed(piece)
    return reader


def check(reader: PacketReader) -> None:
    assert reader.complete
    info = reader.info
    assert info.version == "5.12.4.1101661"
    assert info.robot_type == 7
    assert info.calibration.checksum == CHECKSUM
    assert info.calibration.theta == THETA
    assert info.calibration.a == A
    assert info.calibration.d == D
    assert info.calibration.alpha == ALPHA


def test_known_answer():
    check(read(STREAM))


@given(st.lists(st.integers(0, len(STREAM)), max_size=20))
def test_however_it_is_split(cuts):
    places = [0, *sorted(cuts), len(STREAM)]
    check(read(*(STREAM[i:j] for i, j in itertools.pairwise(places))))


@given(st.integers(0, len(STREAM) - 1))
def test_what_is_not_there_yet_is_none(end):
    reader = read(STREAM[:end])
    assert not reader.complete
    assert (reader.info.version is not None) == (end >= len(VERSION))


@pytest.mark.parametrize(
    "data",
    [
        struct.pack(">iB", 4, 16),
        struct.pack(">iB", -1, 16),
        struct.pack(">iB", 1 << 21, 16),
        framed(16, framed(5, bytes(10))),
        framed(16, struct.pack(">iB", 500, 5)),
        framed(16, b"\0"),
        framed(20, bytes(9)),
        framed(20, bytes(9) + b"\x03"),
        framed(16, framed(5, struct.pack(">6I24d", *CHECKSUM, *[math.nan] * 24))),
    ],
)
def test_what_is_no_packet_is_refused(data):
    with pytest.raises(PrimaryError):
        read(data)


@given(st.binary(max_size=300))
def test_random_bytes_raise_nothing_else(data):
    reader = PacketReader()
    try:
        reader.feed(data)
    except PrimaryError:
        return
    assert reader.info.calibration is None


EXCEPTION = framed(
    20, struct.pack(">Qbbii", 1, -2, 10, 2, 3) + b"compile_error_name_not_found:foo:\0"
)


def log_entry(level: int, text: bytes = b"Unstable power") -> bytes:
    return framed(20, struct.pack(">QbbiiiII", 1, -2, 6, 50, 80, level, 0, 0) + text)


def test_what_is_said_against_a_program_is_told_in_words():
    reader = MessageReader()
    stream = STREAM + EXCEPTION + log_entry(1) + log_entry(2) + log_entry(3, b"")
    found = [text for i in range(len(stream)) for text in reader.feed(stream[i : i + 1])]
    assert found == [
        "compile_error_name_not_found:foo: (line 2, column 3)",
        "C50A80 Unstable power",
        "C50A80",
    ]


@pytest.mark.parametrize("body", [b"", bytes(9), struct.pack(">Qbb", 1, -2, 10) + b"\0\0"])
def test_a_message_that_is_too_short_is_refused(body):
    with pytest.raises(PrimaryError):
        MessageReader().feed(framed(20, body))


@given(st.binary(max_size=300))
def test_random_bytes_are_messages_or_refused(data):
    reader = MessageReader()
    try:
        assert all(isinstance(text, str) for text in reader.feed(data))
    except PrimaryError:
        return
