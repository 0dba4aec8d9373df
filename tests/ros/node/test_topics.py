"""What the node offers and publishes: names, types, QoS, stamps, frames, manifest, diagnostics."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from pathlib import Path

from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from crtk_drivers.config import NodeConfig
from crtk_drivers.engine import Engine
from crtk_drivers.ros.topics import coherent
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_node import RATE, Rig, rig_of, serve
from rigs.ros_client import COMMANDED, PUBLISHED, TRANSIENT, Inbox, RosClient, stamp_ns
from rigs.waiting import eventually

JOINTS = ["x", "y", "z", "yaw"]
NEVER_OFFERED = ("use_gravity_compensation", "local/servo_cp", "body/servo_cp", "measured2_js")
LATCHED = ("operating_state", "refusals", "goal_js", "goal_cp")


def topic(rig: Rig, name: str) -> str:
    return f"{rig.client.namespace}/{name}"


QOS_FILE = """
/**:
  ros__parameters:
    qos_overrides:
      /filed/measured_js:
        publisher: {reliability: best_effort}
      /filed/servo_jp:
        subscription: {depth: 7}
"""


def test_topics_are_those_of_the_capabilities(rig: Rig) -> None:
    present = dict(rig.client.node.get_topic_names_and_types())
    for name in (*PUBLISHED, *COMMANDED):
        assert topic(rig, name) in present
        assert len(present[topic(rig, name)]) == 1, "the node and the client differ in type"
    for name in NEVER_OFFERED:
        assert topic(rig, name) not in present


def test_what_is_published_is_reliable(rig: Rig) -> None:
    for name in PUBLISHED:
        (info,) = rig.client.node.get_publishers_info_by_topic(topic(rig, name))
        assert info.qos_profile.reliability is ReliabilityPolicy.RELIABLE, name
        latched = name in LATCHED or name.startswith("trajectory_j/")
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        assert info.qos_profile.durability is durability, name


def test_what_is_received_is_volatile(rig: Rig) -> None:
    for name in COMMANDED:
        (info,) = rig.client.node.get_subscriptions_info_by_topic(topic(rig, name))
        assert info.qos_profile.reliability is ReliabilityPolicy.RELIABLE, name
        assert info.qos_profile.durability is DurabilityPolicy.VOLATILE, name


def test_feedback_of_one_sample_has_one_stamp(rig: Rig) -> None:
    client = rig.client
    names = ("measured_js", "measured_cp", "measured_cv", "measured_cf", "local/measured_cp")
    since = {name: client[name].mark() for name in names}

    def common() -> int:
        stamps = ({stamp_ns(m) for m in client[name].messages[since[name] :]} for name in names)
        return len(set.intersection(*stamps) - {0})

    eventually(lambda: common() > 20, "twenty samples on all topics")
    told = max(client[name].mark() - since[name] for name in names)
    assert told < 3 * common(), "most have the same"


def test_a_sample_that_comes_in_between_is_noticed() -> None:
    device = LoopbackDevice()
    engine = Engine(device, "loopback")
    engine.connect(time.monotonic() + 1.0)
    engine.cycle(time.monotonic())

    class Names(list[str]):
        """Names between two of which, the first time, a new sample arrives."""

        interrupted = False

        def __iter__(self) -> Iterator[str]:
            for name in super().__iter__():
                yield name
                if not self.interrupted:
                    self.interrupted = True
                    engine.cycle(time.monotonic())

    names = Names(["measured_js", "measured_cp", "measured_cv"])
    stamps = {found[1].wall_ns for found in coherent(engine, names).values() if found}
    assert names.interrupted
    assert len(stamps) == 1
    engine.shut_down()


def test_a_stamp_is_when_the_sample_was_taken(rig: Rig) -> None:
    found = rig.session.engine.feedback("measured_js")
    assert found is not None
    newer = rig.client["measured_js"].wait(
        lambda m: stamp_ns(m) >= found[1].wall_ns, rig.client["measured_js"].mark()
    )
    assert list(newer.name) == JOINTS
    assert len(newer.position) == len(newer.velocity) == len(newer.effort) == 4


def test_frames_carry_the_namespace(rig: Rig) -> None:
    prefix = rig.client.namespace.strip("/")
    expected = {
        "measured_js": f"{prefix}/base",
        "setpoint_js": f"{prefix}/base",
        "measured_cp": f"{prefix}/base",
        "measured_cv": f"{prefix}/base",
        "measured_cf": f"{prefix}/base",
        "local/measured_cp": f"{prefix}/base",  # its base is its own
    }
    for name, frame in expected.items():
        assert rig.client[name].wait().header.frame_id == frame


def test_joints_are_told_in_the_frame_of_the_pose_also_where_the_base_has_a_place() -> None:
    place = {"position": [1.0, 0.0, 0.5], "frame_id": "table"}
    with rig_of("/placed", base=place) as rig:
        rig.client.reach("enable", "ENABLED")
        rig.client.send("move_jp", JointState(position=[0.01, 0.0, 0.0, 0.0]))
        frames = {
            name: rig.client[name].wait().header.frame_id
            for name in ("measured_js", "setpoint_js", "goal_js", "measured_cp")
        }
    assert set(frames.values()) == {"placed/table"}, frames


def test_tf_is_measured_cp_and_never_local(rig: Rig) -> None:
    prefix = rig.client.namespace.strip("/")
    inbox = rig.client["/tf"]
    assert rig.client.set_parameter("tf_rate", 400.0)  # samples come at 40 Hz
    # What another node told before is not this one's, and was heard before the answer.
    began = inbox.mark()
    inbox.wait(since=began + 30)
    heard = inbox.messages[began:]
    frames = {(t.header.frame_id, t.child_frame_id) for m in heard for t in m.transforms}
    assert frames == {(f"{prefix}/base", f"{prefix}/tool")}
    stamps = [stamp_ns(m.transforms[0]) for m in heard]
    assert len(stamps) == len(set(stamps))

    def common() -> int:
        measured = {stamp_ns(m) for m in rig.client["measured_cp"].messages}
        return sum(stamp_ns(m.transforms[0]) in measured for m in inbox.messages[began:])

    eventually(lambda: common() > 10, "they are those of the pose")


def test_old_data_is_published_with_stamp_zero(rig: Rig) -> None:
    client = rig.client
    for name in ("measured_js", "measured_cp", "measured_cv"):
        assert stamp_ns(client[name].wait(lambda m: stamp_ns(m) > 0, client[name].mark())) > 0
    rig.device.silent = True
    for name in ("measured_js", "measured_cp", "measured_cv"):
        since = client[name].mark()
        invalid = client[name].wait(lambda m: stamp_ns(m) == 0, since)
        assert invalid is not None
        client[name].wait(lambda m: stamp_ns(m) == 0, client[name].mark())
    assert client["operating_state"].wait(lambda m: m.state == "FAULT").state == "FAULT"
    tf_messages = client["/tf"].messages
    assert all(stamp_ns(m.transforms[0]) > 0 for m in tf_messages)


def test_setpoint_depends_on_the_command(rig: Rig) -> None:
    client = rig.client
    client.reach("enable", "ENABLED")
    since = client["setpoint_js"].mark()

    def by_positions() -> list[JointState]:
        client.send("servo_jp", JointState(position=[0.005, 0.0, 0.0, 0.0]))
        told = client["setpoint_js"].messages[since:]
        return [m for m in told if len(m.position) == 4 and m.position[0] == 0.005]

    by_position = eventually(by_positions, "setpoint_js shows the position")[0]
    assert list(by_position.name) == JOINTS
    assert len(by_position.velocity) == 0
    client.send("hold", Empty())
    since = client["setpoint_js"].mark()
    # two streams may not mix: wait until the first is over
    eventually(lambda: rig.session.engine.health().stream == "", "the stream of servo_jp has ended")
    seen = client["setpoint_cp"].mark()

    def stream() -> bool:
        client.send("servo_jv", JointState(velocity=[0.0, 0.02, 0.0, 0.0]))
        return any(
            len(m.position) == 0 and list(m.velocity) == [0.0, 0.02, 0.0, 0.0]
            for m in client["setpoint_js"].messages[since:]
        )

    eventually(stream, "setpoint_js shows the velocity and no position")
    assert client["setpoint_cp"].wait(lambda m: stamp_ns(m) == 0, seen)


def test_goals_are_latched_for_those_who_come_later(rig: Rig) -> None:
    client = rig.client
    client.reach("enable", "ENABLED")
    client.move("move_jp", JointState(position=[0.02, 0.03, 0.0, 0.1]))
    goal = client["goal_js"].wait(lambda m: list(m.position) == [0.02, 0.03, 0.0, 0.1])
    assert list(goal.name) == JOINTS
    late: list[JointState] = []
    with RosClient("/nobody") as other:
        other.node.create_subscription(JointState, topic(rig, "goal_js"), late.append, TRANSIENT)
        eventually(lambda: bool(late), "the goal arrives")
    assert list(late[0].position) == [0.02, 0.03, 0.0, 0.1]
    assert stamp_ns(late[0]) == stamp_ns(goal)


def test_move_reaches_its_goal(rig: Rig) -> None:
    client = rig.client
    client.reach("enable", "ENABLED")
    goal = [0.05, 0.0, -0.05, 0.2]
    client.move("move_jp", JointState(position=goal))
    client["measured_js"].wait(
        lambda m: all(abs(a - b) < 1e-3 for a, b in zip(m.position, goal, strict=True)),
        client["measured_js"].mark(),
    )
    pose = PoseStamped()
    pose.header.frame_id = client["measured_cp"].wait().header.frame_id
    pose.pose.position.x = 0.1
    client.move("move_cp", pose)
    client["measured_cp"].wait(
        lambda m: abs(m.pose.position.x - 0.1) < 1e-3, client["measured_cp"].mark()
    )


def test_increments_add_up(rig: Rig) -> None:
    client = rig.client
    client.reach("enable", "ENABLED")
    for _ in range(100):
        client.send("servo_jr", JointState(position=[0.0002, 0.0, 0.0, 0.0]))
    client["measured_js"].wait(
        lambda m: abs(m.position[0] - 0.02) < 1e-4, client["measured_js"].mark()
    )


def test_servo_cv_moves_the_tool(rig: Rig) -> None:
    client = rig.client
    client.reach("enable", "ENABLED")
    twist = TwistStamped()
    twist.twist.linear = Vector3(x=0.1, y=0.0, z=0.0)

    def stream() -> bool:
        client.send("servo_cv", twist)
        return bool(client["measured_cp"].messages[-1].pose.position.x > 0.01)

    eventually(stream, "the tool has moved along x")


def test_jacobian(rig: Rig) -> None:
    message = rig.client["jacobian"].wait()
    assert [d.size for d in message.layout.dim] == [6, 4]
    assert [d.stride for d in message.layout.dim] == [24, 4]
    assert message.data[0] == 1.0
    assert message.data[-1] == 1.0


def test_manifest(rig: Rig) -> None:
    content = json.loads(rig.client["crtk_driver/crtk_capabilities"].wait().data)
    assert content["schema"] == "crtk_capabilities/1"
    assert set(content["commands"]) >= {*COMMANDED, *PUBLISHED} - {"refusals"}
    assert content["commands"]["servo_cp"]["type"] == "geometry_msgs/msg/PoseStamped"
    assert content["commands"]["servo_cp"]["name"] == topic(rig, "servo_cp")
    assert [joint["name"] for joint in content["joints"]] == JOINTS
    assert content["stop"]["stream_timeout"] == 0.1
    assert content["rates"]["io"] == RATE
    prefix = rig.client.namespace.strip("/")
    assert content["frames"] == {"base": f"{prefix}/base", "tool": f"{prefix}/tool"}


def test_a_node_has_its_own_parameters_and_no_others(rig: Rig) -> None:
    node = rig.serving.driver.node
    own = {*NodeConfig.model_fields, "use_sim_time", "start_type_description_service"}
    assert set(node.get_parameters_by_prefix("")) == own


def test_diagnostics(rig: Rig) -> None:
    inbox = rig.client["/diagnostics"]
    report = inbox.wait(lambda m: m.status[1].message == "OK", inbox.mark())
    assert [s.name.rpartition(": ")[2] for s in report.status] == ["device", "bus", "commands"]
    assert report.status[0].hardware_id == "loopback loopback"
    values = {v.key: v.value for v in report.status[1].values}
    assert math.isclose(float(values["expected rate (Hz)"]), RATE)
    assert {"late cycles", "sample age (ms)", "rate (Hz)"} <= set(values)
    rig.device.silent = True
    fault = inbox.wait(lambda m: m.status[0].level == b"\x02", inbox.mark())
    assert "sample" in fault.status[0].message


def test_names_can_be_remapped_and_qos_overridden() -> None:
    args = ["--ros-args", "-r", "__ns:=/elsewhere", "-r", "measured_js:=joint_states"]
    args += ["-p", "frame_prefix:=left_", "-p", "publish_rate:=20.0"]
    args += ["-p", "qos_overrides./elsewhere/joint_states.publisher.reliability:=best_effort"]
    with serve(LoopbackConfig(), "/ignored", args) as (_, serving):
        node = serving.driver.node
        (info,) = node.get_publishers_info_by_topic("/elsewhere/joint_states")
        assert info.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT
        assert node.get_namespace() == "/elsewhere"
        assert node.get_parameter("publish_rate").value == 20.0
        assert node.get_parameter("frame_prefix").value == "left_"
        overrides = set(node.get_parameters_by_prefix("qos_overrides./elsewhere/joint_states"))
        assert overrides == {
            f"publisher.{policy}" for policy in ("history", "depth", "reliability")
        }


def test_qos_can_be_overridden_in_a_file_of_parameters(tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(QOS_FILE)
    with serve(LoopbackConfig(), "/filed", ["--ros-args", "--params-file", str(file)]) as (
        _,
        served,
    ):
        node = served.driver.node
        (info,) = node.get_publishers_info_by_topic("/filed/measured_js")
        assert info.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT
        overrides = [name for name in node.get_parameters_by_prefix("") if "/filed/" in name]
        assert len(overrides) == 6, "three policies of each end that was named"
        assert node.get_parameter("qos_overrides./filed/servo_jp.subscription.depth").value == 7


def test_devices_do_not_share_frames(rig: Rig) -> None:
    expected = {f"{rig.client.namespace.strip('/')}/tool", "left/tool", "right/tool"}
    with rig_of("/left") as left, rig_of("/right") as right:
        for each in (left, right):
            inbox = each.client["/tf"]

            def frames(inbox: Inbox = inbox) -> set[str]:
                return {message.transforms[0].child_frame_id for message in inbox.messages}

            eventually(lambda frames=frames: expected <= frames(), "all arms are on /tf")
            assert frames() == expected
