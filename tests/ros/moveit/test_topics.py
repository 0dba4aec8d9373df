"""Topics for MoveIt and its Servo: published beside those of CRTK, and taken as controllers take them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from control_msgs.action import FollowJointTrajectory
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from crtk_drivers import plugins
from crtk_drivers.config import NodeConfig, from_values, load
from crtk_drivers.ros.serving import Serving
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from rigs.action_client import ABORTED, ActionAsker, as_moveit, set_duration
from rigs.loopback_node import served
from rigs.moveit_node import MoveItRig
from rigs.ros_client import Inbox
from rigs.waiting import LONG, eventually

SPACE = "/topics_of"
PREFIX = "left_"
FOR_LONG = 30.0
"""Seconds of what is ended on its way, however long that takes."""
NODE = NodeConfig(moveit=True, joint_prefix=PREFIX)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Topics:
    """A served virtual arm, and a client's ends."""

    def __init__(self, rig: MoveItRig, serving: Serving) -> None:
        self.rig = rig
        node = rig.asker.node
        self.names = [PREFIX + name for name in rig.names]
        self.publishers = {
            name: node.create_publisher(kind, f"{SPACE}/{name}", 10)
            for name, kind in (
                ("joint_trajectory", JointTrajectory),
                ("forward_position_controller/commands", Float64MultiArray),
                ("forward_velocity_controller/commands", Float64MultiArray),
            )
        }
        self.heard: dict[str, Inbox] = {}
        for name, kind, profile in (
            ("joint_states", JointState, QoSProfile(depth=10)),
            ("robot_description", String, LATCHED),
            ("/tf", TFMessage, QoSProfile(depth=10)),
        ):
            inbox = self.heard[name] = Inbox()
            topic = name if name.startswith("/") else f"{SPACE}/{name}"
            node.create_subscription(kind, topic, inbox, profile)
        ours = list(self.publishers.values())
        names = {publisher.topic_name for publisher in ours}
        theirs = [each for each in serving.driver.node.subscriptions if each.topic_name in names]
        eventually(lambda: all(each.get_subscription_count() for each in ours), "it is found")
        eventually(lambda: all(each.get_publisher_count() for each in theirs), "it has found them")

    def send(self, name: str, message: Any) -> None:
        self.publishers[name].publish(message)

    def trajectory(self, *points: JointTrajectoryPoint) -> JointTrajectory:
        return JointTrajectory(joint_names=self.names, points=list(points))


def point(seconds: float, **fields: Any) -> JointTrajectoryPoint:
    made = JointTrajectoryPoint(**{name: [float(v) for v in row] for name, row in fields.items()})
    set_duration(made.time_from_start, seconds)
    return made


@pytest.fixture(scope="module")
def shared() -> Iterator[Topics]:
    plugin = plugins.device("virtual")
    limits = {"max_command_age": 10.0}
    values = {**plugin.typical, "rate": 200.0, "sample_timeout": 3.0, "limits": limits}
    session = Session(plugin, load(plugin.config, from_values(values)))
    action = f"{SPACE}/follow_joint_trajectory"
    with (
        served(session, SPACE, (), NODE) as serving,
        ActionAsker(FollowJointTrajectory, action) as asker,
    ):
        yield Topics(MoveItRig(session, asker, SPACE), serving)


@pytest.fixture
def topics(shared: Topics) -> Topics:
    shared.rig.reach("disable", OperatingState.DISABLED)
    shared.rig.enabled()
    return shared


def test_joint_states_have_the_prefix_and_all_that_is_measured(topics: Topics) -> None:
    told = topics.heard["joint_states"].wait()
    assert list(told.name) == topics.names
    assert np.array(told.position) == pytest.approx(topics.rig.joints(), abs=0.05)
    assert len(told.velocity) == len(topics.names)
    assert told.header.stamp.sec > 0


def test_the_description_names_the_same_joints_and_no_frame_of_tf_twice(topics: Topics) -> None:
    text = topics.heard["robot_description"].wait().data
    for name in topics.names:
        assert f'<joint name="{name}" type=' in text
    sent = topics.heard["/tf"].wait(
        lambda m: m.transforms[0].header.frame_id.startswith("topics_of")
    )
    child = sent.transforms[0].child_frame_id
    assert f'<link name="{child}"' not in text, "robot_state_publisher would publish it too"


def test_a_trajectory_on_the_topic_is_gone_along(topics: Topics) -> None:
    begin = topics.rig.joints()
    rest = np.zeros_like(begin)
    rows = [point(0.3 * i, positions=begin + 0.03 * i, velocities=rest) for i in range(3)]
    topics.send("joint_trajectory", topics.trajectory(*rows))
    there = pytest.approx(begin + 0.06, abs=0.01)
    eventually(lambda: topics.rig.joints() == there, "it goes there")
    eventually(lambda: not topics.rig.engine.status.is_busy, "it has gone")
    assert topics.rig.joints() == there


def test_a_trajectory_on_the_topic_replaces_a_goal_and_an_empty_one_ends_it(topics: Topics) -> None:
    begin = topics.rig.joints()
    rows = [(0.0, begin), (FOR_LONG, begin + 0.2)]
    for message in (
        topics.trajectory(point(1.0, positions=begin, velocities=np.zeros_like(begin))),
        topics.trajectory(),
    ):
        asked = topics.rig.asker.ask(as_moveit(topics.names, rows))
        eventually(lambda: bool(asked.feedback), "it is on its way")  # noqa: B023
        topics.send("joint_trajectory", message)
        status, result = asked.wait()
        assert (status, result.error_code) == (ABORTED, -1)
        topics.rig.engine.submit("hold")
        eventually(lambda: not topics.rig.engine.status.is_busy, "it has ended")
        rows = [(0.0, topics.rig.joints()), (FOR_LONG, topics.rig.joints() + 0.05)]


def of_elbow(*points: JointTrajectoryPoint) -> JointTrajectory:
    return JointTrajectory(joint_names=["elbow"], points=list(points))


LAST = {
    "forward_position_controller/commands": (Float64MultiArray(data=[0.0]), "servo_jp: wrong_size"),
    "forward_velocity_controller/commands": (Float64MultiArray(data=[0.0]), "servo_jv: wrong_size"),
    "joint_trajectory": (of_elbow(point(0.01, positions=[0.0])), "interpolate_jp: wrong_size"),
}
"""What is refused on a topic, and how: then all that was sent before has been heard."""


def stream(topics: Topics, name: str, message: Any, moved: Any) -> None:
    """Publish a message again and again, as Servo does, until `moved`; nothing of it is left on its way."""

    def sent() -> bool:
        topics.send(name, message)
        return bool(moved())

    eventually(sent, f"{name} moves it")
    nonsense, refused = LAST[name]

    def heard() -> int:
        return topics.rig.engine.health().refusals.get(refused, 0)

    before = heard()
    topics.send(name, nonsense)
    eventually(lambda: heard() > before, "all of it has been heard")
    eventually(lambda: not topics.rig.engine.health().stream, "the stream has ended")


def test_points_of_servo_are_a_stream_of_positions_or_velocities(topics: Topics) -> None:
    engine = topics.rig.engine
    begin = topics.rig.joints()
    position = point(0.034, positions=begin + 0.02, velocities=np.full_like(begin, 0.01))
    stream(
        topics,
        "joint_trajectory",
        topics.trajectory(position),
        lambda: np.abs(topics.rig.joints() - begin - 0.02).max() < 0.005,
    )
    assert not engine.status.is_busy
    begin = topics.rig.joints()
    slow = np.full_like(begin, -0.05)
    stream(
        topics,
        "joint_trajectory",
        topics.trajectory(point(0.034, velocities=slow)),
        lambda: (topics.rig.joints() < begin - 0.005).all(),
    )


def test_a_stop_is_not_lost_behind_the_next_point_while_the_driver_is_held_up(
    topics: Topics,
) -> None:
    engine, here = topics.rig.engine, [float(value) for value in topics.rig.joints()]
    is_held, goes_on = threading.Event(), threading.Event()
    heard: list[str] = []

    def hear(name: str, value: object, stamp_ns: int) -> None:
        heard.append(name)
        if name == "servo_jp":
            is_held.set()
            goes_on.wait(LONG)

    before = engine.hearers
    engine.hearers = (*before, hear)
    try:
        topics.send("forward_position_controller/commands", Float64MultiArray(data=here))
        assert is_held.wait(LONG)
        topics.send("joint_trajectory", topics.trajectory())
        topics.send("joint_trajectory", topics.trajectory(point(0.1, positions=here)))
        assert topics.publishers["joint_trajectory"].wait_for_all_acked(Duration(seconds=LONG))
        goes_on.set()
        eventually(lambda: "interpolate_jp" in heard, "the point is heard")
        assert heard == ["servo_jp", "hold", "interpolate_jp"]
    finally:
        goes_on.set()
        engine.hearers = before


def test_a_point_of_servo_that_is_too_old_is_refused(topics: Topics) -> None:
    engine = topics.rig.engine
    late = topics.trajectory(point(0.034, positions=topics.rig.joints()))
    late.header.stamp.sec = 7
    topics.send("joint_trajectory", late)
    eventually(lambda: "interpolate_jp: too_old" in engine.health().refusals, "it is refused")
    assert not engine.health().stream


def test_forward_commands_are_servo_commands_in_the_order_of_the_joints(topics: Topics) -> None:
    begin = topics.rig.joints()
    rates = np.zeros_like(begin)
    rates[1] = 0.1
    stream(
        topics,
        "forward_velocity_controller/commands",
        Float64MultiArray(data=rates.tolist()),
        lambda: topics.rig.joints()[1] > begin[1] + 0.005,
    )
    assert topics.rig.joints()[0] == pytest.approx(begin[0], abs=0.003)
    begin = topics.rig.joints()
    there = begin + 0.004
    stream(
        topics,
        "forward_position_controller/commands",
        Float64MultiArray(data=there.tolist()),
        lambda: np.abs(topics.rig.joints() - there).max() < 0.002,
    )


BAD = [
    ("forward_position_controller/commands", Float64MultiArray(data=[0.0]), "servo_jp"),
    ("forward_velocity_controller/commands", Float64MultiArray(data=[float("nan")] * 7), "servo_jv"),
    ("joint_trajectory", of_elbow(point(0.01, positions=[0.0])), "interpolate_jp"),
    ("joint_trajectory", of_elbow(point(9.0, positions=[0.0])), "follow_joint_trajectory"),
    ("joint_trajectory", of_elbow(point(0.01, positions=[0.0]), point(0.02)), "follow_joint_trajectory"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "message", "command"), BAD)
def test_what_is_no_command_of_this_arm_is_refused(
    topics: Topics, name: str, message: Any, command: str
) -> None:
    def refused() -> int:
        counted = topics.rig.engine.health().refusals.items()
        return sum(count for key, count in counted if key.startswith(f"{command}: "))

    before = refused()
    topics.send(name, message)
    eventually(lambda: refused() == before + 1, "it is refused")
