"""What a recording holds is what ROS 2 would have sent, to the byte, and the definitions are those of ROS."""

from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import given, settings
from rclpy.serialization import deserialize_message, serialize_message

from crtk_drivers.recording import cdr
from crtk_drivers.recording.mcap_writer import definition
from crtk_drivers.ros.messages import fill, fill_status, set_stamp
from crtk_drivers.state import Status
from rigs.recorded_values import STAMPS, VALUES, WORDS

pytestmark = pytest.mark.ros


def ros_type(type_name):
    package, _, name = type_name.partition("/msg/")
    return getattr(import_module(f"{package}.msg"), name)


def message_of(value, stamp_ns, frame_id):
    message = ros_type(cdr.TYPE_NAMES[type(value)])()
    message.header.frame_id = getattr(value, "frame_id", "") or frame_id
    if isinstance(value, Status):
        fill_status(message, value, stamp_ns)
    else:
        set_stamp(message.header.stamp, stamp_ns)
        fill(message, value)
    return message


@settings(max_examples=30)
@given(VALUES, STAMPS, WORDS)
def test_the_bytes_are_those_of_ros(value, stamp_ns, frame_id):
    message = message_of(value, stamp_ns, frame_id)
    ours, theirs = cdr.encode(value, stamp_ns, frame_id), serialize_message(message)
    assert 0 <= len(theirs) - len(ours) <= 12  # for padding that it then did not write
    # Fast CDR leaves padding as it finds it: where bytes differ, ours are zero.
    assert not any(mine for mine, other in zip(ours, theirs, strict=False) if mine != other)
    assert repr(deserialize_message(ours, type(message))) == repr(message)


@settings(max_examples=30)
@given(VALUES, STAMPS, WORDS)
def test_what_ros_wrote_is_read(value, stamp_ns, frame_id):
    theirs = serialize_message(message_of(value, stamp_ns, frame_id))
    found = cdr.decode(cdr.TYPE_NAMES[type(value)], theirs)
    assert found.stamp_ns == stamp_ns
    assert cdr.encode(found.value, stamp_ns, found.frame_id) == cdr.encode(
        value, stamp_ns, frame_id
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
