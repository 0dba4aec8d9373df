"""Bytes that are no message of their type are told, counted and passed over by the client."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from crtk_msgs.msg import OperatingState as OperatingStateMessage
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import Float64, Float64MultiArray, String

from crtk_drivers.cli import main
from crtk_drivers.client import RemoteDevice, connect
from crtk_drivers.client.discovery import Catalogue
from crtk_drivers.client.goals import arrival_of
from crtk_drivers.client.inbox import Inbox, Received, Unreadable
from crtk_drivers.commands import find
from crtk_drivers.errors import ConnectionFailed, DataTimeout
from crtk_drivers.recording import cdr
from crtk_drivers.ros import qos
from crtk_drivers.ros.manifest import MANIFEST
from crtk_drivers.samples import JointState, Number, Text, vector
from crtk_drivers.state import OperatingState, Status
from rigs.loopback_client import Node
from rigs.waiting import LONG, eventually

SIX = JointState(vector([0.5] * 6))
HEARD = (
    JointStateMessage,
    OperatingStateMessage,
    Float64,
    Float64MultiArray,
    String,
    DiagnosticArray,
)


def joints(position: float = 0.5, stamp_ns: int | None = None) -> bytes:
    value = JointState(vector([position] * 6), vector([0.1] * 6))
    return cdr.encode(value, time.time_ns() if stamp_ns is None else stamp_ns, "base")


def unlike_sizes() -> bytes:
    """A joint state of one position and six velocities."""
    whole, short = joints(), cdr.encode(JointState(vector([0.5])), time.time_ns(), "base")
    return short[:-8] + whole[-(4 + 4 + 48 + 4) :]


BAD = {
    "nothing": b"",
    "only a header": joints()[:16],
    "cut off": joints()[:-20],
    "too long": joints() + bytes(64),
    "not CDR": b"\x00\x0a" + joints()[2:],
    "a count of 2^32 - 1": joints()[:24] + b"\xff" * 4 + joints()[28:],
}


@pytest.fixture
def inbox() -> Inbox:
    return Inbox("/arm/measured_js", JointStateMessage)


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD)
def test_it_is_passed_over(inbox: Inbox, bad: bytes, caplog: pytest.LogCaptureFixture) -> None:
    values = []
    inbox.add_listener(lambda received: values.append(received.value))
    inbox.receive(bad)
    assert inbox.wait_for(lambda received: True, 0.0) is None
    inbox.receive(joints())
    assert inbox.wait_for(lambda received: True, 0.0) is not None
    inbox.receive(bad)
    inbox.receive(bad)
    assert (len(values), inbox.unreadable) == (1, 3)
    (warning,) = [record.getMessage() for record in caplog.records]
    assert warning == f"a message on /arm/measured_js cannot be read: {inbox.problem}"


def test_it_counts_once_however_often_it_is_asked_for(inbox: Inbox) -> None:
    inbox.receive(joints()[:-20])
    for _ in range(3):
        assert inbox.readable() is None
    assert inbox.unreadable == 1


def test_a_move_is_not_taken_for_arrived(inbox: Inbox) -> None:
    at_goal = arrival_of(find("move_jp"), inbox, SIX, None, 0).at_goal
    inbox.receive(joints())
    assert at_goal() is True
    inbox.receive(joints()[:-20])
    assert at_goal() is None


@given(st.sampled_from(HEARD), st.binary(max_size=200), st.sampled_from((0, 1)))
def test_no_bytes_raise_into_the_thread_that_spins(kind: Any, data: bytes, order: int) -> None:
    inbox = Inbox("/anything", kind)
    asked: list[Received] = []

    def ask(received: Received) -> None:
        asked.append(received)
        received.value if kind is not DiagnosticArray else received.message  # noqa: B018

    inbox.add_listener(ask)
    for whole in (data, bytes((0, order, 0, 0)) + data):
        inbox.receive(whole)
    assert len(asked) + inbox.unreadable >= 2


def test_what_is_of_no_type_that_is_read_here_has_no_value() -> None:
    inbox = Inbox("/diagnostics", DiagnosticArray)
    inbox.receive(cdr.encode(Text(""), 1))
    assert inbox.latest is not None
    with pytest.raises(Unreadable, match="cannot be read here"):
        inbox.latest.value  # noqa: B018 - asking is the test


class Other:
    """A device of another maker, without a manifest, that sends what the test gives it."""

    def __init__(self, node: Any, namespace: str) -> None:
        self.joints = node.create_publisher(JointStateMessage, f"{namespace}/measured_js", 10)
        self.setpoint = node.create_publisher(JointStateMessage, f"{namespace}/setpoint_js", 10)
        self.state = node.create_publisher(
            OperatingStateMessage, f"{namespace}/operating_state", 10
        )
        self.told = node.create_publisher(String, f"{namespace}/refusals", qos.REFUSALS)


@pytest.fixture(scope="module")
def ends() -> Iterator[tuple[RemoteDevice, Other]]:
    with Node("hostile") as node:
        other = Other(node.node, "/hostile")
        enabled = cdr.encode(Status(OperatingState.ENABLED), time.time_ns())
        timer = node.node.create_timer(0.05, lambda: other.state.publish(enabled))
        with connect("/hostile", features=["measured_js", "operating_state"]) as arm:
            node.node.destroy_timer(timer)
            yield arm, other


def test_feedback_over_dds(ends: tuple[RemoteDevice, Other]) -> None:
    arm, other = ends
    inbox = arm._space.connected("measured_js")
    eventually(other.joints.get_subscription_count, "they have met")
    bad = (*BAD.values(), unlike_sizes())
    for number, data in enumerate(bad):
        other.joints.publish(joints(number))
        eventually(lambda n=number: float(arm.measured_jp(age=0, wait=LONG)[0]) == n, "it is heard")
        before = inbox.unreadable
        other.joints.publish(data)

        def told(before: int = before) -> bool:
            inbox.readable()
            return bool(inbox.unreadable > before)

        eventually(told, "it was looked at")
    with pytest.raises(DataTimeout, match=r"measured_js: .*different sizes.*same definition"):
        arm.measured_js(age=0, wait=0.0)
    other.joints.publish(joints(9.0))
    eventually(lambda: float(arm.measured_jp(age=0, wait=LONG)[0]) == 9.0, "it goes on")


def test_what_was_never_anything_else_is_told_over_dds(ends: tuple[RemoteDevice, Other]) -> None:
    arm, other = ends
    inbox = arm._space.connected("setpoint_js")
    eventually(other.setpoint.get_subscription_count, "they have met")
    other.setpoint.publish(b"")
    eventually(lambda: inbox.unreadable == 1, "it was looked at")
    with pytest.raises(DataTimeout, match=r"setpoint_js: it begins with nothing"):
        arm.setpoint_js(age=0, wait=0.0)


def test_operating_state_and_refusals_over_dds(ends: tuple[RemoteDevice, Other]) -> None:
    arm, other = ends
    tracker = arm._space.status()
    unknown = cdr.encode(Status(OperatingState.ENABLED), time.time_ns()).replace(
        b"ENABLED", b"EXPLODE"
    )
    refusals = tracker.subscribe()[1]
    eventually(other.told.get_subscription_count, "they have met")
    for box, publisher, data in (
        (tracker.inbox, other.state, unknown),
        (tracker.inbox, other.state, unknown[:-9]),
        (refusals, other.told, b"\x00\x01\x00\x00\xff\xff\xff\x7f"),
    ):
        before = box.unreadable
        publisher.publish(data)
        eventually(lambda box=box, before=before: box.unreadable > before, "it was looked at")
        assert tracker.latest.state is OperatingState.ENABLED
    other.state.publish(cdr.encode(Status(OperatingState.PAUSED), time.time_ns()))
    assert arm.wait_for_status(lambda status: status.state is OperatingState.PAUSED, LONG)


def test_messages_of_any_type_over_dds(ends: tuple[RemoteDevice, Other]) -> None:
    arm, other = ends
    heard: list[Any] = []
    end = arm.on_message("refusals", heard.append)
    try:
        for data in (b"", b"\x00\x01\x00\x00\xff\xff\xff\x7f", bytes(3)):
            other.told.publish(data)
        other.told.publish(String(data="last"))
        eventually(lambda: bool(heard), "the good one is heard")
        assert heard == [String(data="last")]
    finally:
        end()


def test_a_number() -> None:
    inbox = Inbox("/arm/trajectory_j/ratio", Float64)
    inbox.receive(cdr.encode(Number(0.5), 0))
    found = inbox.readable()
    assert found is not None
    assert found.value == Number(0.5)
    assert found.wall_ns > 0  # when it arrived: it has no stamp


@pytest.mark.parametrize("text", ["[" * 100_000, '{"commands": 5}', "[1]", "{"])
def test_a_text_that_is_no_manifest_leaves_the_one_before(text: str) -> None:
    inbox = Inbox("/arm/driver/crtk_capabilities", String)
    link: Any = SimpleNamespace(
        topics=lambda: [inbox.topic], publishers=lambda topic: 1, text_inbox=lambda topic: inbox
    )
    catalogue = Catalogue(link, "/arm")
    catalogue.look()
    for told in ('{"name": "arm", "commands": {}}', text):
        inbox.receive(serialize_message(String(data=told)))
        assert catalogue.manifest == {"name": "arm", "commands": {}}


NOT_AS_TOLD = {
    "a service without a name": {"services": {"x": {}}},
    "services in a list": {"services": ["x"]},
    "no readings": {"readings": None},
    "children that are no names": {"children": [1, {}]},
    "no children": {"children": None},
    "joints without names": {"joints": [{"lower": 0.0}]},
    "joints that are numbers": {"joints": [1]},
    "limits that are words": {"joints": [{"name": "x", "lower": "low"}]},
    "a device that is a number": {"device": {"name": 1, "model": [2]}},
    "rates in a list": {"rates": [1]},
    "control characters": {"services": {"\x1b[2J": {"name": "/odd_told/\x1b[2Jx", "type": "t"}}},
}


@pytest.fixture(scope="module")
def odd() -> Iterator[Any]:
    """A device, and what publishes its manifest."""
    with Node("odd_told") as other:
        node, namespace = other.node, "/odd_told"
        state = node.create_publisher(OperatingStateMessage, f"{namespace}/operating_state", 10)
        joints = node.create_publisher(JointStateMessage, f"{namespace}/measured_js", 10)
        told = node.create_publisher(String, f"{namespace}/node/{MANIFEST}", qos.LATCHED)

        def tell() -> None:
            stamp = node.get_clock().now().to_msg()
            status = OperatingStateMessage(state="DISABLED", is_homed=True)
            message = JointStateMessage(name=["x"], position=[1.0])
            status.header.stamp = message.header.stamp = stamp
            state.publish(status)
            joints.publish(message)

        node.create_timer(0.05, tell)
        yield told


@pytest.mark.parametrize("content", NOT_AS_TOLD.values(), ids=NOT_AS_TOLD)
def test_a_manifest_with_wrong_types_is_used_as_far_as_it_goes(
    odd: Any, content: dict[str, Any], capfd: pytest.CaptureFixture[str]
) -> None:
    topics = {
        "operating_state": "crtk_msgs/msg/OperatingState",
        "measured_js": "sensor_msgs/msg/JointState",
    }
    commands = {name: {"name": f"/odd_told/{name}", "type": kind} for name, kind in topics.items()}
    odd.publish(String(data=json.dumps({"commands": commands, **content})))
    assert main(["state", "/odd_told"]) == 0
    out = capfd.readouterr().out
    assert "DISABLED" in out
    assert "1.0000" in out
    assert "\x1b" not in out
    with (
        connect("/odd_told") as device,
        pytest.raises(ConnectionFailed, match="there is nothing in jaw/"),
    ):
        device.child("jaw", timeout=2.0)
