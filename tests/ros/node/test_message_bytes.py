"""The bytes that the drivers send, record and read are those of ROS 2, and the definitions too."""

from contextlib import suppress
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64MultiArray, String
from tf2_msgs.msg import TFMessage

from crtk_drivers.recording import cdr
from crtk_drivers.recording.cdr_transforms import decode_transforms
from crtk_drivers.recording.mcap_writer import definition
from crtk_drivers.ros.manifest import type_name
from crtk_drivers.samples import Matrix, Text
from rigs.examples import examples
from rigs.message_values import NUMBERS, POSES, STAMPS, VALUES, WORDS, fields
from rigs.ros_messages import message_of

pytestmark = pytest.mark.ros

MATRICES = st.tuples(st.integers(0, 7), st.integers(0, 7)).map(
    lambda shape: Matrix(np.arange(float(shape[0] * shape[1])).reshape(shape))
)


def same_bytes(ours, message):
    """Whether bytes are those of a message, but for padding: Fast CDR leaves that as it finds it."""
    theirs = serialize_message(message)
    assert 0 <= len(theirs) - len(ours) <= 12  # for padding that it then did not write
    assert not any(mine for mine, other in zip(ours, theirs, strict=False) if mine != other)
    assert repr(deserialize_message(ours, type(message))) == repr(message)
    return True


@settings(max_examples=examples(100))
@given(VALUES | MATRICES, STAMPS, WORDS)
def test_the_bytes_are_those_of_ros(value, stamp_ns, frame_id):
    message = message_of(value, stamp_ns, frame_id)
    assert same_bytes(cdr.encode(value, stamp_ns, frame_id), message)


@settings(max_examples=examples(30))
@given(POSES, STAMPS, WORDS, WORDS)
def test_the_bytes_of_a_transform_are_those_of_ros(pose, stamp_ns, frame_id, child):
    message = transform_of(pose, stamp_ns, frame_id, child)
    ours = cdr.encode_transform(pose, stamp_ns, frame_id, child)
    assert same_bytes(ours, TFMessage(transforms=[message]))


def transform_of(pose, stamp_ns, frame_id, child):
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = pose.position.tolist()
    rotation.x, rotation.y, rotation.z, rotation.w = pose.orientation.tolist()
    return message


@settings(max_examples=30)
@given(st.lists(st.tuples(POSES, STAMPS, WORDS, WORDS), max_size=4))
def test_all_transforms_of_a_message_are_read(each):
    data = serialize_message(TFMessage(transforms=[transform_of(*one) for one in each]))
    found = decode_transforms(data)
    assert [(one.stamp_ns, one.pose.frame_id, one.child) for one in found] == [
        (stamp_ns, frame_id, child) for _, stamp_ns, frame_id, child in each
    ]
    for one, (pose, *_) in zip(found, each, strict=True):
        assert one.pose.position.tobytes() == pose.position.tobytes()
        assert one.pose.orientation.tobytes() == pose.orientation.tobytes()


@given(st.binary(max_size=60))
def test_bytes_that_are_no_transforms_are_refused(data):
    with suppress(cdr.Malformed):
        decode_transforms(data)


@settings(max_examples=examples(100))
@given(VALUES, STAMPS, WORDS)
def test_what_ros_wrote_is_read(value, stamp_ns, frame_id):
    message = message_of(value, stamp_ns, frame_id)
    found = cdr.decode(type_name(type(message)), serialize_message(message))
    if hasattr(message, "header"):
        assert (found.stamp_ns, found.frame_id) == (stamp_ns, frame_id)
    assert fields(found.value) == fields(value)


@settings(max_examples=examples(30))
@given(st.lists(NUMBERS, max_size=9).map(lambda numbers: np.array([numbers])))
def test_of_a_matrix_the_numbers_are_read(numbers):
    message = message_of(Matrix(numbers))
    found = cdr.decode("std_msgs/msg/Float64MultiArray", serialize_message(message)).value
    assert np.array(found.values).tobytes() == numbers.tobytes()


@settings(max_examples=examples(30))
@given(MATRICES)
def test_a_matrix_is_read(matrix):
    found = cdr.decode_matrix(serialize_message(message_of(matrix)))
    assert found.values.shape == matrix.values.shape
    assert np.array_equal(found.values, matrix.values)
    assert not found.values.flags.writeable


def test_an_array_without_a_layout_is_one_row():
    numbers = cdr.decode_matrix(serialize_message(Float64MultiArray(data=[1.0, 2.0])))
    assert numbers.values.tolist() == [[1.0, 2.0]]


@given(WORDS)
def test_words_are_read(words):
    assert cdr.decode("std_msgs/msg/String", serialize_message(String(data=words))).value == Text(
        words
    )


@pytest.mark.parametrize("type_name", cdr.TYPE_NAMES.values())
def test_the_definitions_are_those_of_ros(type_name):
    share = Path(import_module("std_msgs").__file__).parents[4] / "share"
    parts = f"MSG: {type_name}\n{definition(type_name)}".split("=" * 80 + "\n")
    assert len(parts) > 2
    for part in parts:
        head, *lines = part.splitlines()
        package, name = head.removeprefix("MSG: ").replace("/msg/", "/").split("/")
        text = (share / package / "msg" / f"{name}.msg").read_text()
        theirs = [line.partition("#")[0].split() for line in text.splitlines()]
        assert [line.split() for line in lines] == [words for words in theirs if words]
