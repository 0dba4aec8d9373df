"""Our interface packages are, on the wire, those of the packages whose names they bear.

Two nodes connect only when their types have one RIHS01 hash. The expected ones were computed from
crtk_msgs 1.3.0, control_msgs 5.8.0 and controller_manager_msgs of Jazzy as their authors publish them. That
of TFMessage is what a ROS 2 Jazzy installation shows in `ros2 topic info -v /tf`.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import control_msgs.msg
import controller_manager_msgs.msg
import controller_manager_msgs.srv
import crtk_msgs.msg
import pytest
import rclpy
import tf2_msgs.msg
from rclpy.context import Context
from rclpy.node import Node

pytestmark = pytest.mark.ros

MESSAGES = {
    control_msgs.msg.GripperCommand: (
        "57eb8f326c9889ca8bb34ead82cc94cc09bf6bc5c3b6c09546dca3a00b589890"
    ),
    control_msgs.msg.JointComponentTolerance: (
        "739ea7566931944d33830fa10f1bf5e7a7fbdc3172bce7a7eaac642bd6e3ffa4"
    ),
    control_msgs.msg.JointTolerance: (
        "c254f9cece0f3b733017b6990fd46d1326e25242d6b8844398c97d9a88e7d648"
    ),
    controller_manager_msgs.msg.ControllerState: (
        "9a8780ab9814b6032978a07c6c7033cf1a7894ac8d948a6fb72afea07b04cc83"
    ),
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

MANAGER = {
    "ListControllers": "4f8e36bb1fa5afdeba45c2d56ae6a2097b1493a253f961dd6290c085033bd189",
    "ListHardwareComponents": "2ff105e609928671af16413362c0fdd089e1dd50c5a49d830db603ba8e4439c8",
    "SetHardwareComponentState": "940b15846ed3e1fb561ab45edf77a992b811fd59c574f45d5205a84a0deb2f65",
    "SwitchController": "d4ad10aa5da7808bc522d55d4123d8ef79de73d049d165639d7663ac37cc9895",
}
"""ListHardwareComponents of later releases has another one."""

SERVICES = {
    "QueryForwardKinematics": "5906fc58a120dbfa461f62abf0cd0d6e57d0967fa79ea4838b2d342e06d65323",
    "QueryInverseKinematics": "a2ead2f28d548d1b8589033207d18095262a0a07cf3eb290cb4af77b679960be",
    "TriggerOperatingState": "364ceef23563859e687f916bb77ba0c376c081cccce83eb6c576e14a6f8f8372",
}


ACTIONS = {
    "FollowJointTrajectory": {
        "": "738ebcb7a2d7cfa42f9f1001cc99ce3a4383d1cfe508015d9be8485e4b1c66f6",
        "_Goal": "8a9060704b269608f5a340934cc26e66869dd14bdac29e2e7fd9ec8b9882d205",
        "_Result": "8002e99ed2c14c6faa522f2a93c26d744c5982f254f9e98ff9c6f19789bdb220",
        "_SendGoal": "b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
        "_GetResult": "e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
        "_FeedbackMessage": "80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    },
    "GripperCommand": {
        "": "e17c0e644eccf14bea84a0a93e0977182872c2eb7873ca6694900059b46dbc84",
        "_SendGoal": "6bf8cc4ce80cd499e7dd3258c03c50c3fa6672b469ff8355339ef1df77fcd212",
        "_GetResult": "7e60a7606063d4a2728d21badac099e68b734a196ac3ab42d1d4c668eb0bb3cd",
        "_FeedbackMessage": "392ff03fcd872f9dc2405cbeb2897fcf011ad9998458b6aa85c603b8a49e431d",
    },
    "ParallelGripperCommand": {
        "": "adfd3c1ebe8abc38ebcc0e454b6423d291d4010dd5697d14eca5b9be4726ae18",
    },
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
    name = f"crtk_msgs/srv/{service}"
    assert described(name)[name] == f"RIHS01_{SERVICES[service]}"


@pytest.mark.parametrize("service", MANAGER)
def test_the_hash_of_a_service_of_the_controller_manager_is_that_of_jazzy(service: str) -> None:
    name = f"controller_manager_msgs/srv/{service}"
    assert described(name)[name] == f"RIHS01_{MANAGER[service]}"


def test_a_switch_is_strict_by_the_number_that_the_manager_knows() -> None:
    request = controller_manager_msgs.srv.SwitchController.Request
    assert (request.BEST_EFFORT, request.STRICT) == (1, 2)
    assert (request.AUTO, request.FORCE_AUTO) == (3, 4)


@pytest.mark.parametrize("action", ACTIONS)
def test_the_hashes_of_an_action_and_its_parts_are_those_of_jazzy(action: str) -> None:
    name = f"control_msgs/action/{action}"
    hashes = described(name)
    assert {part: hashes[name + part] for part in ACTIONS[action]} == {
        part: f"RIHS01_{expected}" for part, expected in ACTIONS[action].items()
    }


def described(name: str) -> dict[str, str]:
    """Return the hashes of a type and what it is made of, by their names."""
    share = Path(crtk_msgs.__file__).parents[4] / "share"
    description = json.loads((share / f"{name}.json").read_text())
    return {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}


def test_setpoint_modes_are_bits_which_no_hash_covers() -> None:
    mode = crtk_msgs.msg.SetpointMode
    assert (mode.NONE, mode.POSITION, mode.VELOCITY, mode.EFFORT) == (0, 1, 2, 4)
    assert (mode.P, mode.V, mode.F) == (mode.POSITION, mode.VELOCITY, mode.EFFORT)
    assert (mode.PV, mode.PF, mode.VF, mode.PVF) == (3, 5, 6, 7)
