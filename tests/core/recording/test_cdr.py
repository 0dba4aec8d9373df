"""Values as ROS 2 messages in bytes, without ROS: back and forth, and bytes that are no message."""

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.recording import cdr
from crtk_drivers.recording.cdr import Malformed
from crtk_drivers.samples import (
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    Matrix,
    Number,
    Numbers,
    Pose,
    Text,
    Twist,
    vector,
)
from crtk_drivers.state import OperatingState, Status
from rigs.message_values import STAMPS, VALUES, WORDS, fields

TYPE_NAMES = {
    **cdr.TYPE_NAMES,
    JointServo: "crtk_msgs/msg/JointServo",
    CartesianServo: "crtk_msgs/msg/CartesianServo",
    Number: "std_msgs/msg/Float64",
    Flag: "std_msgs/msg/Bool",
    Numbers: "std_msgs/msg/Float64MultiArray",
}
HEADER = bytes.fromhex("00010000 00000000 00000000 01000000 00000000")
"""Little-endian, stamp 0, an empty frame, and up to a multiple of four."""


def has_header(value):
    return not isinstance(value, Number | Flag | Numbers)


@given(VALUES, STAMPS, WORDS)
def test_a_value_comes_back_as_it_was(value, stamp_ns, frame_id):
    found = cdr.decode(TYPE_NAMES[type(value)], cdr.encode(value, stamp_ns, frame_id))
    assert fields(found.value) == fields(value)
    expected = (stamp_ns, frame_id) if has_header(value) else (0, "")
    assert (found.stamp_ns, found.frame_id) == expected
    if hasattr(found.value, "frame_id"):
        assert found.value.frame_id == frame_id


@pytest.mark.parametrize("sizes", [(2, 2), (0, 3), (2**32 - 1, 2**32 - 1)])
def test_a_layout_that_does_not_fit_its_numbers_is_refused(sizes):
    data = cdr.encode(Matrix(np.zeros((1, 3))), 0)
    rows, columns = (struct.pack("<I", size) for size in sizes)
    changed = data[:20] + rows + data[24:40] + columns + data[44:]
    with pytest.raises(ValueError, match="cannot reshape"):
        cdr.decode_matrix(changed)


@given(st.binary(max_size=200), st.sampled_from((0, 1)))
def test_any_bytes_are_a_matrix_or_refused(data, order):
    with suppress(ValueError):
        cdr.decode_matrix(bytes((0, order, 0, 0)) + data)


def test_the_bytes_of_a_joint_state():
    value = JointState(vector([1.0]), name=("a",))
    expected = (
        "00010000 01000000 02000000"  # little-endian; 1 s and 2 ns
        "03000000 626500 00"  # "be", and up to a multiple of four
        "01000000 02000000 6100 0000"  # one name, "a"
        "01000000 000000000000f03f"  # one position: its count, then 1.0, which is at 32
        "00000000 00000000"
    )
    assert cdr.encode(value, 1_000_000_002, "be") == bytes.fromhex(expected)


def test_the_bytes_of_an_operating_state():
    value = Status(OperatingState.FAULT, is_homed=True)
    expected = "00010000 00000000 00000000 01000000 00 000000 06000000 4641554c5400 01 00"
    assert cdr.encode(value, 0) == bytes.fromhex(expected)


def test_the_bytes_of_a_mixed_setpoint_of_joints():
    value = JointServo((1, 2), vector([1.0, 0.0]))
    expected = (
        HEADER.hex()
        + "00000000 02000000 000000000000f03f 0000000000000000 00000000 00000000 02000000 0102"
    )
    assert cdr.encode(value, 0) == bytes.fromhex(expected)


@given(VALUES, STAMPS, st.data())
def test_a_message_that_was_cut_off_or_is_too_long_is_none(value, stamp_ns, data):
    whole = cdr.encode(value, stamp_ns)
    size = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(Malformed, match="this is no"):
        cdr.decode(TYPE_NAMES[type(value)], whole[:size])
    with pytest.raises(Malformed, match="left over"):
        cdr.decode(TYPE_NAMES[type(value)], whole + bytes(13))


@given(st.sampled_from(sorted(cdr.READABLE)), st.binary(max_size=300), st.sampled_from((0, 1)))
def test_any_bytes_are_a_message_or_an_error(type_name, data, order):
    with suppress(ValueError):
        cdr.decode(type_name, bytes((0, order, 0, 0)) + data)


@given(VALUES, STAMPS, st.data())
def test_a_damaged_message_is_a_message_or_an_error(value, stamp_ns, data):
    damaged = bytearray(cdr.encode(value, stamp_ns))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        damaged[at] = data.draw(st.integers(0, 255))
    with suppress(ValueError):
        cdr.decode(TYPE_NAMES[type(value)], bytes(damaged))


@pytest.mark.parametrize("count", [2, 2**28, 2**31, 2**32 - 1])
@pytest.mark.parametrize("field", range(4))
def test_a_count_beyond_the_end_is_refused_and_takes_no_memory(count, field):
    data = HEADER + bytes(4) * field + struct.pack("<I", count)
    with pytest.raises(Malformed, match=r"bytes too early|are more than"):
        cdr.decode("sensor_msgs/msg/JointState", data)


def test_a_big_endian_message_is_read():
    big = "00000000 00000001 00000002 00000003 626500 00 00000001 00000002 6100 0000 00000001"
    big += "3ff0000000000000 00000000 00000000"
    found = cdr.decode("sensor_msgs/msg/JointState", bytes.fromhex(big))
    assert fields(found.value) == fields(JointState(vector([1.0]), name=("a",)))
    assert (found.stamp_ns, found.frame_id) == (1_000_000_002, "be")


@pytest.mark.parametrize(
    "begins", ["", "00", "0001", "00020000", "00070000", "000a0000", "01010000"]
)
def test_another_representation_is_refused(begins):
    data = bytes.fromhex(begins)
    if len(data) == 4:
        data += HEADER[4:] + bytes(64)
    with pytest.raises(Malformed, match="it begins with"):
        cdr.decode("geometry_msgs/msg/PoseStamped", data)


def test_a_text_that_is_none_is_refused():
    with pytest.raises(Malformed, match="not UTF-8"):
        cdr.decode("crtk_msgs/msg/StringStamped", HEADER + bytes.fromhex("03000000 c328 00"))
    for text in ("03000000 610061", "03000000 000000"):
        with pytest.raises(Malformed, match="a zero in it"):
            cdr.decode("crtk_msgs/msg/StringStamped", HEADER + bytes.fromhex(text))


@pytest.mark.parametrize(
    ("text", "expected"), [("00000000", ""), ("01000000 00", ""), ("02000000 6161", "aa")]
)
def test_a_text_may_lack_its_closing_zero(text, expected):
    found = cdr.decode("crtk_msgs/msg/StringStamped", HEADER + bytes.fromhex(text))
    assert found.value == Text(expected)


def test_a_text_that_no_message_can_hold_is_told_all_the_same():
    data = cdr.encode(Text("pick\0place\ud800"), 0)
    assert cdr.decode("crtk_msgs/msg/StringStamped", data).value == Text("pick\\0place\\ud800")


def test_names_and_numbers_may_be_of_any_sequence():
    joints = JointState(vector([1.0]), name=["a"])
    assert cdr.encode(joints, 0) == cdr.encode(JointState(vector([1.0]), name=("a",)), 0)
    assert cdr.encode(Numbers(np.arange(3.0)), 0) == cdr.encode(Numbers((0.0, 1.0, 2.0)), 0)


@pytest.mark.parametrize("seconds", [0, -1, 2**31 - 1, -(2**31)])
@pytest.mark.parametrize("nanoseconds", [0, 10**9 - 1, 10**9, 2**32 - 1])
def test_whatever_stamp_is_read_can_be_written(seconds, nanoseconds):
    stamp = struct.pack("<iI", seconds, nanoseconds)
    found = cdr.decode(
        "geometry_msgs/msg/PoseStamped", HEADER[:4] + stamp + HEADER[12:] + bytes(56)
    )
    assert found.stamp_ns == (seconds * 10**9 + nanoseconds if nanoseconds < 10**9 else 0)
    cdr.encode(found.value, found.stamp_ns)


def test_more_names_than_anything_has_are_refused_before_they_are_read():
    data = HEADER + struct.pack("<I", 2_000_000) + bytes(8 * 2_000_000)
    with pytest.raises(Malformed, match="2000000 names are more than 4096"):
        cdr.decode("sensor_msgs/msg/JointState", data)


def test_what_follows_a_message_is_passed_over_where_that_is_asked_for():
    data = cdr.encode(Text("disable"), 0) + bytes(100)
    found = cdr.decode("crtk_msgs/msg/StringStamped", data, is_exact=False)
    assert found.value == Text("disable")


def test_vectors_of_unlike_size_are_a_message_but_no_value():
    data = HEADER + bytes.fromhex("00000000 01000000 0000000000000000 02000000") + bytes(4 + 16 + 4)
    with pytest.raises(ValueError, match="different sizes") as caught:
        cdr.decode("sensor_msgs/msg/JointState", data)
    assert not isinstance(caught.value, Malformed)


@pytest.mark.parametrize(
    ("value", "stamp_ns", "words"),
    [
        ("a", 0, "a str cannot be a message"),
        (Text("a"), 1 << 62, "cannot be a message"),
        (Text("a"), -(1 << 62), "cannot be a message"),
        (Pose(vector([1.0]), vector([1.0])), 0, "cannot be a message"),
        (JointServo((256,)), 0, "range"),
    ],
)
def test_what_no_message_can_hold_is_refused(value, stamp_ns, words):
    with pytest.raises(ValueError, match=words):
        cdr.encode(value, stamp_ns)


def test_a_type_that_is_not_known_cannot_be_read():
    data = cdr.encode(Twist(vector([0] * 3), vector([0] * 3)), 0)
    with pytest.raises(ValueError, match="std_msgs/msg/Empty cannot be read"):
        cdr.decode("std_msgs/msg/Empty", data)
