"""Finding devices, ours and others; what is missing; a driver that starts again; whose thread spins."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from crtk_msgs.msg import OperatingState as OperatingStateMessage
from crtk_msgs.msg import StringStamped
from geometry_msgs.msg import PoseStamped, TransformStamped
from sensor_msgs.msg import JointState as JointStateMessage

from crtk_drivers.client import RemoteDevice, connect
from crtk_drivers.errors import (
    CommandRefused,
    ConfigError,
    ConnectionFailed,
    ConnectionLost,
    DataTimeout,
    DeviceError,
    MotionAborted,
)
from crtk_drivers.testing.loopback import LoopbackConfig
from rigs.loopback_client import Node, driver_process, far_device
from rigs.loopback_node import SLOWLY, serve
from rigs.programs import Start
from rigs.waiting import LONG, eventually


@pytest.fixture(scope="module")
def served() -> Iterator[str]:
    with serve(LoopbackConfig(), "/client_connect", []):
        yield "/client_connect"


def test_nobody_there(served: str) -> None:
    with Node("who_knows") as mine:
        eventually(lambda: mine.node.count_publishers(f"{served}/operating_state"), "it knows one")
        with pytest.raises(ConnectionFailed) as info:
            connect("/nobody", timeout=0.5, node=mine.node)
    text = str(info.value)
    assert "no CRTK device in the namespace /nobody within 0.5 s" in text
    assert served in text
    assert "ROS_DOMAIN_ID" in text


def test_a_namespace_that_is_none() -> None:
    with pytest.raises(ConfigError, match=r"Try: /my_arm"):
        connect("/my arm")


def test_ros_arguments_that_are_none(served: str) -> None:
    with pytest.raises(ConfigError, match=r"ROS does not accept"):
        connect(served, ros_args=["--ros-args", "--nonsense"])


def test_only_what_is_asked_for_is_subscribed(served: str) -> None:
    with connect(served) as arm, Node("looker") as looker:

        def listeners(name: str) -> int:
            return int(looker.node.count_subscribers(f"{served}/{name}"))

        eventually(lambda: looker.node.count_publishers(f"{served}/measured_js") == 1, "it is seen")
        assert arm.measured_js().position.size == 4
        eventually(lambda: listeners("measured_js") == 1, "what is used is subscribed")
        for name in ("measured_cp", "measured_cv", "setpoint_js", "operating_state", "refusals"):
            assert listeners(name) == 0, name


def test_features_are_set_up_at_once(served: str) -> None:
    with connect(served, features=["measured_jp", "local/measured_cp", "operating_state"]) as arm:
        arm.check_connections(timeout=0.0)
        assert arm.measured_jp(wait=LONG).size == 4
    with pytest.raises(
        ConnectionFailed, match=r"does not offer use_gravity.*It offers: measured_js"
    ):
        connect(served, features=["use_gravity_compensation"])


def test_remapped_topics_are_found_by_the_manifest() -> None:
    arguments = ["--ros-args", "-r", "measured_js:=/elsewhere/joint_states"]
    with (
        serve(LoopbackConfig(), "/client_remapped", arguments),
        connect("/client_remapped") as arm,
    ):
        assert arm.measured_js(wait=LONG).position.size == 4


def test_a_node_of_mine(served: str) -> None:
    with Node("mine") as mine, connect(served, node=mine.node) as arm:
        arm.enable()
        assert arm.measured_js().position.size == 4
        arm.disable()
    with Node("mine") as mine, connect(served, executor=mine.executor) as arm:
        arm.enable()
        arm.disable()


def test_a_node_that_nobody_spins(served: str) -> None:
    mine = Node("idle")
    count = mine.node.count_publishers
    try:
        for name in ("measured_js", "operating_state"):
            eventually(lambda: count(f"{served}/{name}") == 1, f"{name} is seen")  # noqa: B023
        with connect(served, node=mine.node, timeout=1.0) as arm:
            with pytest.raises(DataTimeout, match=r"is it spun"):
                arm.measured_js(wait=0.2)
            with pytest.raises(DataTimeout, match=r"is it spun"):
                arm.operating_state()
    finally:
        with mine:
            pass


def test_a_device_without_a_manifest() -> None:
    """As dVRK: no manifest, no refusals, no operating_state service, a jaw under its parent's state."""
    with Node("psm1_driver") as other:
        node, namespace = other.node, "/PSM1"
        state = node.create_publisher(OperatingStateMessage, f"{namespace}/operating_state", 10)
        joints = node.create_publisher(JointStateMessage, f"{namespace}/measured_js", 10)
        jaw = node.create_publisher(JointStateMessage, f"{namespace}/jaw/measured_js", 10)
        node.create_publisher(TransformStamped, f"{namespace}/measured_cp", 10)
        moved: list[float] = []
        status = OperatingStateMessage(state="DISABLED", is_homed=True)

        def tell() -> None:
            stamp = node.get_clock().now().to_msg()
            status.header.stamp = stamp
            state.publish(status)
            for publisher, position in ((joints, [1.0, 2.0]), (jaw, [0.3])):
                message = JointStateMessage(position=position)
                message.header.stamp = stamp
                publisher.publish(message)

        def command(message: StringStamped) -> None:
            status.state = "ENABLED" if message.string == "enable" else "DISABLED"

        def move(message: JointStateMessage) -> None:
            moved.extend(message.position)
            for status.is_busy in (True, False):
                tell()

        node.create_timer(0.05, tell)
        node.create_subscription(StringStamped, f"{namespace}/state_command", command, 10)
        node.create_subscription(JointStateMessage, f"{namespace}/move_jp", move, 10)
        node.create_subscription(JointStateMessage, f"{namespace}/jaw/servo_jp", move, 10)
        with connect("PSM1") as arm:
            assert arm.manifest == {}
            names = {"measured_js", "move_jp", "jaw/measured_js", "jaw/servo_jp"}
            eventually(lambda: names <= set(arm.crtk_commands), "they are found")
            assert list(arm.measured_jp()) == [1.0, 2.0]
            assert list(arm.jaw.measured_jp()) == [0.3]
            arm.enable(timeout=LONG)
            assert arm.jaw.is_enabled()
            assert arm.move_jp([0.5, 0.6]).wait(LONG)
            assert moved == [0.5, 0.6]
            arm.jaw.servo_jp([0.2])
            eventually(lambda: moved == [0.5, 0.6, 0.2], "the jaw was told")
            eventually(lambda: "measured_cp" in arm.crtk_commands, "it is found, too")
            with pytest.raises(AttributeError, match=r"TransformStamped.* never meet"):
                arm.measured_cp  # noqa: B018 - asking is the test
            with pytest.raises(AttributeError, match=r"does not offer servo_jp"):
                arm.servo_jp  # noqa: B018 - asking is the test


@pytest.mark.slow
def test_every_command_of_the_table_is_sent_and_received() -> None:
    """Also those that the official client lacks, and that no driver of ours offers yet."""
    from crtk_drivers.commands import COMMANDS, Direction, Payload
    from crtk_drivers.front.base import PARTS
    from crtk_drivers.ros.messages import TYPES

    seen: list[str] = []
    mixed = (Payload.JOINT_SERVO, Payload.CARTESIAN_SERVO)
    values = {
        Payload.JOINT_STATE: [0.1],
        Payload.POSE: [0.0] * 6 + [1.0],
        Payload.NUMBER: 0.5,
        Payload.FLAG: True,
    }

    def method(arm: RemoteDevice, name: str) -> Any:
        space, _, last = name.rpartition("/")
        return getattr(getattr(arm, space) if space else arm, last)

    with Node("everything") as other:
        publishers = []
        for name, command in COMMANDS.items():
            topic, kind = f"/everything/{name}", TYPES[command.payload]
            if command.direction is Direction.PUBLISHED:
                publishers.append(other.node.create_publisher(kind, topic, 10))
            elif command.direction is Direction.COMMANDED:
                other.node.create_subscription(
                    kind, topic, lambda message, name=name: seen.append(name), 10
                )

        def tell() -> None:
            for publisher in publishers:
                message = publisher.msg_type()
                if hasattr(message, "header"):
                    message.header.stamp = other.node.get_clock().now().to_msg()
                if isinstance(message, OperatingStateMessage):
                    message.state = "ENABLED"
                publisher.publish(message)

        other.node.create_timer(0.05, tell)
        with connect("/everything") as arm:
            sent = [n for n, c in COMMANDS.items() if c.direction is Direction.COMMANDED]
            arm.add(*sent)
            for name in set(sent) - {"state_command"}:
                payload = COMMANDS[name].payload
                if payload is Payload.EMPTY:
                    method(arm, name)()
                elif payload in mixed:
                    method(arm, name)(TYPES[payload]())
                elif name.startswith("move_"):
                    getattr(arm, name)(values[payload])
                else:
                    method(arm, name)(values.get(payload, [0.0] * 6))
            arm.enable()
            eventually(lambda: set(seen) == set(sent), "each has arrived")
            for name, command in COMMANDS.items():
                if command.direction is Direction.PUBLISHED and name != "operating_state":
                    assert method(arm, name)(wait=LONG) is not None, name
            for name in PARTS:
                getattr(arm, name)(age=0)


def test_what_is_missing_is_named(served: str) -> None:
    with Node("half") as half:
        publisher = half.node.create_publisher(PoseStamped, "/half/measured_cp", 10)
        listener = half.node.create_subscription(JointStateMessage, "/half/servo_jp", print, 10)
        with connect("/half", features=["measured_cp", "servo_jp"]) as arm:
            arm.check_connections()
            half.node.destroy_publisher(publisher)
            half.node.destroy_subscription(listener)
            eventually(lambda: not arm.crtk_commands, "they are gone")
            ends = arm._space.all_endpoints()
            eventually(lambda: not any(end.connected for end in ends), "each end knows that")
            with pytest.raises(ConnectionFailed) as info:
                arm.check_connections(timeout=0.2)
            assert re.search("nobody publishes /half/measured_cp", str(info.value))
            assert re.search("nobody listens to /half/servo_jp", str(info.value))
            with pytest.raises(ConnectionLost, match=r"nobody listens to /half/servo_jp any more"):
                arm.servo_jp([0.0])
            with pytest.raises(DataTimeout, match=r"nobody publishes it"):
                arm.measured_cp(wait=0.1)


def enabled(arm: RemoteDevice) -> bool:
    """Whether a driver that may still be starting is enabled now."""
    try:
        arm.enable()
    except (CommandRefused, DeviceError):
        return False
    return True


def test_a_driver_that_starts_again(start: Start) -> None:
    with driver_process(start, "/client_restart") as again:
        first = again()
        with connect("/client_restart", timeout=LONG) as arm:
            eventually(lambda: enabled(arm), "it can be enabled")
            arm.add("servo_jp", "measured_js")
            arm.trajectory_j.set_ratio(SLOWLY)
            eventually(
                lambda: arm.trajectory_j.ratio() == SLOWLY, "it is not over before the driver is"
            )
            move = arm.move_jp([0.9, 0.0, 0.0, 0.0])
            first.terminate()
            # either its last status or its silence is heard first
            with pytest.raises((ConnectionLost, MotionAborted)):
                move.wait()
            first.wait(LONG)
            with pytest.raises(ConnectionLost, match=r"nobody listens"):
                eventually(lambda: arm.servo_jp([0.0] * 4) is not None, "it is gone")
            with pytest.raises(ConnectionLost, match=r"nobody publishes"):
                eventually(lambda: arm.operating_state() is None, "that is gone, too")
            again()
            arm.check_connections(timeout=LONG)
            eventually(lambda: enabled(arm), "the new one can be enabled")
            assert arm.move_jp([0.05, 0.0, 0.0, 0.0]).wait(LONG)
            assert abs(arm.setpoint_jp()[0] - 0.05) < 1e-3


def test_closing_twice() -> None:
    with far_device("/client_close") as far:
        far.arm.measured_js()
        far.arm.close()
        far.arm.close()
