"""Values as ROS 2 messages in bytes, without ROS: back and forth, and bytes that are no message."""

from contextlib import suppress
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording import cdr
from crtk_drivers.samples import JointState, Number, Pose, Text, Twist, vector
from crtk_drivers.state import OperatingState, Status
from rigs.recorded_values import STAMPS, VALUES, WORDS, fields


@given(VALUES, STAMPS, WORDS)
def test_a_value_comes_back_as_it_was(value, stamp_ns, frame_id):
    data = cdr.encode(value, stamp_ns, frame_id)
    found = cdr.decode(cdr.TYPE_NAMES[type(value)], data)
    assert type(found.value) is type(value)
    frame = getattr(value, "frame_id", "") or frame_id
    if hasattr(value, "frame_id"):
        value = replace(value, frame_id=frame)
    assert fields(found.value) == fields(value)
    assert (found.stamp_ns, found.frame_id) == (stamp_ns, frame)


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


@given(VALUES, STAMPS, st.data())
def test_a_message_that_was_cut_off_is_none(value, stamp_ns, data):
    whole = cdr.encode(value, stamp_ns)
    size = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises(RecordingError, match="this is no"):
        cdr.decode(cdr.TYPE_NAMES[type(value)], whole[:size])
    with pytest.raises(RecordingError, match="left over"):
        cdr.decode(cdr.TYPE_NAMES[type(value)], whole + bytes(13))


@given(st.sampled_from(sorted(cdr.TYPE_NAMES.values())), st.binary(max_size=200))
def test_any_bytes_are_a_message_or_an_error(type_name, data):
    with suppress(RecordingError):
        cdr.decode(type_name, b"\x00\x01\x00\x00" + data)


@pytest.mark.parametrize(
    ("value", "stamp_ns", "words"),
    [
        (Number(1.0), 0, "a Number cannot be recorded"),
        (Text("a\0b"), 0, "a zero in it"),
        (Text("a"), 1 << 62, "cannot be recorded"),
        (Text("a"), -(1 << 62), "cannot be recorded"),
        (Pose(vector([1.0]), vector([1.0])), 0, "cannot be recorded"),
    ],
)
def test_what_no_message_can_hold_is_refused(value, stamp_ns, words):
    with pytest.raises(RecordingError, match=words):
        cdr.encode(value, stamp_ns)


def test_a_type_that_is_not_recorded_cannot_be_read():
    data = cdr.encode(Twist(vector([0] * 3), vector([0] * 3)), 0)
    with pytest.raises(RecordingError, match="std_msgs/msg/Empty cannot be read"):
        cdr.decode("std_msgs/msg/Empty", data)
