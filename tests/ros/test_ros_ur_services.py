"""Services and inputs of a UR arm on ROS 2: they have names that ROS accepts, and reach the controller."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from ros_client import RosClient
from ros_rig import until
from std_msgs.msg import Bool, Float64
from ur_rig import ur_on_ros

from crtk_drivers.session import Session

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

    until(sent, name)


def test_every_service_and_input_is_in_the_manifest(ur):
    session, client = ur
    content = json.loads(client["crtk_driver/crtk_capabilities"].wait().data)
    assert set(session.engine.services) <= set(content["services"])
    assert set(session.engine.inputs) <= set(content["inputs"])
    assert content["inputs"]["digital_out_0"]["type"] == "std_msgs/msg/Bool"
    assert content["inputs"]["tool_voltage"]["type"] == "std_msgs/msg/Float64"


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


def test_services_answer_and_refuse(ur):
    _, client = ur
    told = client.trigger("robot_mode")
    assert (told.success, told.message) == (True, "RUNNING")
    refused = client.trigger("unlock_protective_stop")
    assert not refused.success
    assert "NORMAL" in refused.message
