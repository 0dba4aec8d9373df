"""Services and inputs of a UR arm on ROS 2: they have names that ROS accepts, and reach the controller."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from crtk_msgs.msg import StringStamped
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Bool, Float64

from crtk_drivers.ros import qos
from crtk_drivers.session import Session
from rigs.ros_client import RosClient
from rigs.ur_node import ur_on_ros
from rigs.waiting import eventually

NAMESPACE = "/test_ros_ur_services"


@pytest.fixture(scope="module")
def ur() -> Iterator[tuple[Session, RosClient]]:
    with ur_on_ros(NAMESPACE) as rig:
        yield rig.session, rig.client


def publish_until(client: RosClient, name: str, message: Any, reached) -> None:
    sender = client.node.create_publisher(type(message), f"{NAMESPACE}/{name}", 10)

    def sent() -> bool:
        sender.publish(message)
        return bool(reached())

    eventually(sent, name)


def test_every_service_and_input_is_in_the_manifest(ur):
    session, client = ur
    content = json.loads(client["crtk_driver/crtk_capabilities"].wait().data)
    assert set(session.engine.services) <= set(content["services"])
    assert set(session.engine.inputs) <= set(content["inputs"])
    assert content["inputs"]["digital_out_0"]["type"] == "std_msgs/msg/Bool"
    assert content["inputs"]["tool_voltage"]["type"] == "std_msgs/msg/Float64"
    assert content["inputs"]["load_program"]["type"] == "crtk_msgs/msg/StringStamped"
    assert set(session.engine.readings) == set(content["readings"])
    assert content["readings"]["digital_in_0"]["name"] == f"{NAMESPACE}/state/digital_in_0"


def test_outputs_are_topics(ur):
    session, client = ur
    outputs = session.sim.control.outputs
    bits = "actual_digital_output_bits"
    publish_until(client, "digital_out_3", Bool(data=True), lambda: outputs(bits)[bits] == 8)
    publish_until(client, "digital_out_3", Bool(data=False), lambda: outputs(bits)[bits] == 0)
    voltage = "tool_output_voltage"
    publish_until(
        client, "tool_voltage", Float64(data=24.0), lambda: outputs(voltage)[voltage] == 24
    )


def heard(client: RosClient, name: str, kind: type) -> list[Any]:
    messages: list[Any] = []
    client.node.create_subscription(kind, f"{NAMESPACE}/state/{name}", messages.append, qos.LATCHED)
    return messages


def test_signals_and_modes_are_topics(ur):
    session, client = ur
    mode = heard(client, "robot_mode", StringStamped)
    signal = heard(client, "digital_in_5", Bool)
    eventually(lambda: mode and signal, "the readings")
    assert (mode[0].string, signal[0].data) == ("RUNNING", False)
    session.sim.control.inject("digital_inputs", bits=1 << 5)
    eventually(lambda: signal[-1].data, "the signal")
    session.sim.control.clear("digital_inputs")
    eventually(lambda: not signal[-1].data, "the signal")


def test_tool_and_programs_are_topics(ur):
    _, client = ur
    tool = heard(client, "tcp", PoseStamped)
    program = heard(client, "loaded_program", StringStamped)
    pose = PoseStamped()
    pose.pose.position.z, pose.pose.orientation.w = 0.15, 1.0
    eventually(lambda: tool, "the tool")
    inbox = client["measured_cp"]
    before = inbox.wait(lambda m: m.header.stamp.sec > 0).pose.position.z
    publish_until(
        client,
        "tcp",
        pose,
        # It points down.
        lambda: abs(inbox.messages[-1].pose.position.z - before + 0.15) < 1e-3,
    )
    publish_until(
        client,
        "load_program",
        StringStamped(string="simulation.urp"),
        lambda: program and program[-1].string.endswith("simulation.urp"),
    )
    refused = client.trigger("pause_program")
    assert not refused.success
    assert "Failed to execute: pause" in refused.message


def test_services_answer_and_refuse(ur):
    _, client = ur
    told = client.trigger("robot_mode")
    assert (told.success, told.message) == (True, "RUNNING")
    refused = client.trigger("unlock_protective_stop")
    assert not refused.success
    assert "NORMAL" in refused.message
