"""Services and inputs of a UR arm on ROS 2: they have names that ROS accepts, and reach the controller."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from ros_client import TIMEOUT, RosClient
from ros_rig import until
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger

from crtk_drivers import plugins
from crtk_drivers.config import NodeConfig
from crtk_drivers.ros.serving import Serving
from crtk_drivers.session import Session, open_session

NAMESPACE = "/test_ros_ur_services"
NOT_ON_A_UR = frozenset(
    {"servo_jf", "servo_cf", "interpolate_cf", "setpoint_cf", "local/measured_cp"}
)


@pytest.fixture(scope="module")
def ur() -> Iterator[tuple[Session, RosClient]]:
    config = plugins.device("ur").load_config(None, {"sample_timeout": 3.0})
    session = open_session("ur", config, sim=True)
    stop = threading.Event()
    with (
        RosClient(NAMESPACE, NOT_ON_A_UR) as client,
        Serving(session.engine, NAMESPACE, (), NodeConfig()) as serving,
        session,
    ):
        thread = threading.Thread(target=serving.spin, args=(stop,), name="test serving")
        thread.start()
        try:
            client.check_connections()
            until(lambda: session.engine.has_sample, "the arm is connected")
            yield session, client
        finally:
            stop.set()
            thread.join()


def publish_until(client: RosClient, name: str, message: Any, reached) -> None:
    sender = client.node.create_publisher(type(message), f"{NAMESPACE}/{name}", 10)

    def sent() -> bool:
        sender.publish(message)
        return bool(reached())

    until(sent, name)


def call(client: RosClient, name: str) -> Any:
    caller = client.node.create_client(Trigger, f"{NAMESPACE}/{name}")
    assert caller.wait_for_service(TIMEOUT)
    answered = threading.Event()
    future = caller.call_async(Trigger.Request())
    future.add_done_callback(lambda _: answered.set())
    assert answered.wait(TIMEOUT)
    return future.result()


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
    told = call(client, "robot_mode")
    assert (told.success, told.message) == (True, "RUNNING")
    refused = call(client, "unlock_protective_stop")
    assert not refused.success
    assert "NORMAL" in refused.message
