"""The main job, end to end: the unmodified vendor library on a simulated controller, served over DDS."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from crtk_msgs.srv import QueryForwardKinematics, QueryInverseKinematics
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from crtk_drivers.ros.manifest import headline
from rigs import ur_watchdog
from rigs.ros_client import stamp_ns
from rigs.ur_node import UrRig, ur_on_ros
from rigs.waiting import LONG, eventually

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture(scope="module")
def ur() -> Iterator[UrRig]:
    with ur_on_ros("/test_ros_ur") as rig:
        yield rig


def test_only_what_the_arm_can_do_has_a_topic(ur: UrRig) -> None:
    topics = dict(ur.client.node.get_topic_names_and_types())
    own = [topic for topic in topics if topic.startswith("/test_ros_ur/")]
    assert "/test_ros_ur/servo_jp" in own
    assert "/test_ros_ur/servo_cf" in own
    assert not [t for t in own if t.rpartition("/")[2] == "servo_jf"]


def test_the_manifest_states_units_limits_and_the_stop_policy(ur: UrRig) -> None:
    content = json.loads(ur.client["crtk_driver/crtk_capabilities"].wait().data)
    assert content["device"]["model"] == "UR5e"
    assert headline(content) == f"UR5e, ur {content['device']['address']}"
    assert content["commands"]["servo_jp"]["type"] == "sensor_msgs/msg/JointState"
    assert content["joints"][0]["name"] == "shoulder_pan_joint"
    assert content["joints"][0]["velocity"] == pytest.approx(np.pi)
    assert content["stop"]["link_timeout"] == pytest.approx(1.0 / ur_watchdog.FREQUENCY)
    assert content["rates"]["io"] == 125.0


def test_feedback_of_one_sample_has_one_stamp_and_one_frame(ur: UrRig) -> None:
    js = ur.client["measured_js"]
    first = js.mark()
    js.wait(since=first + 20)
    stamps = {stamp_ns(m) for m in js.messages}
    same = [m for m in ur.client["measured_cp"].messages if stamp_ns(m) in stamps]
    assert same
    frames = {
        ur.client[name].wait().header.frame_id
        for name in ("measured_cp", "measured_cv", "measured_cf", "setpoint_cp")
    }
    assert frames == {"test_ros_ur/base"}


def test_enable_move_and_arrive(ur: UrRig) -> None:
    ur.enabled()
    goal = ur.joints() + 0.05
    ur.client.move("move_jp", JointState(position=goal.tolist()))
    assert ur.joints() == pytest.approx(goal, abs=1e-3)
    assert (
        ur.client["goal_js"].wait(lambda m: np.allclose(m.position, goal)).name[0]
        == "shoulder_pan_joint"
    )


def test_a_move_that_is_there_already_raises_busy_too(ur: UrRig) -> None:
    ur.enabled()
    inbox = ur.client["setpoint_js"]
    here = inbox.wait(since=inbox.mark()).position
    ur.client.move("move_jp", JointState(position=here))


def test_move_cp_and_kinematics_agree(ur: UrRig) -> None:
    ur.enabled()
    inbox = ur.client["setpoint_cp"]
    goal = inbox.wait(since=inbox.mark())
    goal.pose.position.z += 0.02
    ur.client.move("move_cp", PoseStamped(pose=goal.pose))
    joints = ur.joints().tolist()
    forward = ur.client.call("forward_kinematics", QueryForwardKinematics.Request(jp=joints))
    assert forward.result, forward.message
    assert forward.cp.position.z == pytest.approx(goal.pose.position.z, abs=1e-3)
    inverse = ur.client.call(
        "inverse_kinematics", QueryInverseKinematics.Request(cp=forward.cp, jp=joints)
    )
    assert inverse.result, inverse.message
    assert list(inverse.jp) == pytest.approx(joints, abs=1e-8)


def test_a_servo_stream_is_followed_and_held(ur: UrRig) -> None:
    ur.enabled()
    inbox = ur.client["setpoint_js"]
    start = np.array(inbox.wait(since=inbox.mark()).position)
    target = start.copy()
    for step in range(40):
        target = start + 0.001 * (step + 1)

        def is_told(goal: np.ndarray = target, since: int = inbox.mark()) -> bool:
            ur.enabled()  # the controller pauses what is not fed for half a second
            ur.client.send("servo_jp", JointState(position=goal.tolist()))
            return any(np.allclose(m.position, goal) for m in inbox.messages[since:])

        eventually(is_told, "the setpoint is what was sent")
    eventually(lambda: np.allclose(ur.joints(), target, atol=1e-3), "the arm follows and holds")


def test_nonsense_is_refused_with_a_reason_and_moves_nothing(ur: UrRig) -> None:
    ur.enabled()
    engine = ur.session.engine
    engine.submit("hold")
    samples = engine.health().samples
    eventually(lambda: engine.health().samples > samples + 3, "hold is carried out")
    eventually(lambda: engine.device.takes_setpoints, "it has stopped")
    inbox = ur.client["measured_js"]
    inbox.wait(lambda m: not any(m.velocity), since=inbox.mark())
    before, sent = ur.joints(), engine.health().setpoints
    refusals = ur.client["refusals"]
    for name, message, reason in (
        ("servo_jp", JointState(position=[float("nan")] * 6), "not_finite"),
        ("servo_jp", JointState(position=[0.0] * 5), "wrong_size"),
        ("move_jp", JointState(position=[9.0] * 6), "out_of_range"),
        ("servo_jv", JointState(velocity=[9.0] * 6), "out_of_range"),
    ):

        def is_refused(
            name: str = name, message: JointState = message, reason: str = reason
        ) -> Any:
            ur.enabled()
            ur.client.send(name, message)
            each = map(json.loads, [m.data for m in refusals.messages])
            return next((r for r in each if (r["command"], r["reason"]) == (name, reason)), None)

        assert eventually(is_refused, f"{name} is {reason}")["remedy"]
    assert engine.health().setpoints == sent
    assert ur.joints() == pytest.approx(before, abs=1e-6)


def test_an_emergency_stop_is_fault_with_its_reason_and_enable_recovers(ur: UrRig) -> None:
    assert ur.session.sim is not None
    ur.enabled()
    states = ur.client["operating_state"]
    since = states.mark()
    ur.session.sim.control.inject("emergency_stop")
    states.wait(lambda m: m.state == "FAULT", since)
    eventually(lambda: "emergency stop" in ur.session.engine.status.detail, "the reason is told")
    ur.client.send("hold", Empty())
    eventually(lambda: ur.session.sim.control.status()["robot_mode"] == "POWER_OFF", "power is cut")
    ur.session.sim.control.clear("emergency_stop")
    ur.enabled()


@pytest.mark.slow  # a controller that hears nothing for 0.5 s, as on a busy machine, stops it
@pytest.mark.timeout(4.0 * LONG)
@pytest.mark.parametrize("name", ["move", "servo_at_200_hz", "interpolate_from_20_hz"])
def test_an_example_runs_unchanged_on_the_far_side(ur: UrRig, name: str) -> None:
    ur.enabled()
    script = EXAMPLES / f"{name}.py"
    done = subprocess.run(
        [sys.executable, str(script), "/test_ros_ur"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=3.0 * LONG,  # the controller's time may pass at a fifth of its pace
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert ur.client.state.state == "ENABLED"
