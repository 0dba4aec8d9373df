"""Our interface packages are, on the wire, those of the packages whose names they bear.

Two nodes connect only when their types have one RIHS01 hash. The expected ones were computed from
crtk_msgs 1.3.0 as its authors publish it; that of TFMessage is what a ROS 2 Jazzy installation
shows in `ros2 topic info -v /tf`.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import crtk_msgs.msg
import pytest
import rclpy
import tf2_msgs.msg
from rclpy.context import Context
from rclpy.node import Node

pytestmark = pytest.mark.ros

MESSAGES = {
    crtk_msgs.msg.CartesianImpedance: (
        "9b4e8adf1c59d8045d9bab6c639f8851ec89024ff8bc744fb5b3965143dde7d0"
    ),
    crtk_msgs.msg.CartesianImpedanceHalfPlaneGains: (
        "ab886080cad5164b93d0fb8de83181067f78df6fe72e7d5e0bf15028c7984560"
    ),
    crtk_msgs.msg.CartesianServo: (
        "0acfd530851bb1e631c6f590b6c51d151e2d1af0b34ee0665ac4322f054c7427"
    ),
    crtk_msgs.msg.CartesianState: (
        "edd33cdbe17e19f486ed3cba80b3c894627ea819a8f2b6ad9bdb8db55eac58e6"
    ),
    crtk_msgs.msg.JointServo: "a09603ce45ff956c65ff7faf7b8cc9009ba4bc11e0741f9e5f03716747a0b1fe",
    crtk_msgs.msg.OperatingState: (
        "5cc57eea589b217fe5194bf2735b91d4a7f2dd5ac1245ae657f7ea7590c2c80e"
    ),
    crtk_msgs.msg.SetpointMode: "3e679d1b5c3c04d77b57ea150b3363e26520f33efa75758631f0d80cc525fc12",
    crtk_msgs.msg.StringStamped: "83efb802e6596e03f69ac322e3231037329946f2bd13ed48874d97f5b8f5db1d",
    tf2_msgs.msg.TFMessage: "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
}

SERVICES = {
    "QueryForwardKinematics": "5906fc58a120dbfa461f62abf0cd0d6e57d0967fa79ea4838b2d342e06d65323",
    "QueryInverseKinematics": "a2ead2f28d548d1b8589033207d18095262a0a07cf3eb290cb4af77b679960be",
    "TriggerOperatingState": "364ceef23563859e687f916bb77ba0c376c081cccce83eb6c576e14a6f8f8372",
}


@pytest.fixture(scope="module")
def node() -> Iterator[Node]:
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("message_hashes", context=context)
    yield node
    node.destroy_node()
    context.shutdown()


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.__name__)
def test_the_hash_that_a_publisher_announces_is_the_known_one(node: Node, message: type) -> None:
    publisher = node.create_publisher(message, message.__name__, 1)
    try:
        (endpoint,) = node.get_publishers_info_by_topic(publisher.topic_name)
        assert str(endpoint.topic_type_hash) == f"RIHS01_{MESSAGES[message]}"
    finally:
        node.destroy_publisher(publisher)


@pytest.mark.parametrize("service", SERVICES)
def test_the_hash_of_a_service_is_the_known_one(service: str) -> None:
    prefix = Path(crtk_msgs.__file__).parents[4]
    description = json.loads((prefix / f"share/crtk_msgs/srv/{service}.json").read_text())
    hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
    assert hashes[f"crtk_msgs/srv/{service}"] == f"RIHS01_{SERVICES[service]}"


def test_setpoint_modes_are_bits_which_no_hash_covers() -> None:
    mode = crtk_msgs.msg.SetpointMode
    assert (mode.NONE, mode.POSITION, mode.VELOCITY, mode.EFFORT) == (0, 1, 2, 4)
    assert (mode.P, mode.V, mode.F) == (mode.POSITION, mode.VELOCITY, mode.EFFORT)
    assert (mode.PV, mode.PF, mode.VF, mode.PVF) == (3, 5, 6, 7)
